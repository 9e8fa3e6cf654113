"""Search on problems with a known optimum; sampled pushes and tracks against their constraints."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.geom.assignment import assign
from oes.mpc.sampler import NoFreeStart, PlannerConfig, PushConfig, PushSampler
from oes.mpc.scene import Footprint, PlanningScene, Rod, object_footprint
from oes.mpc.search import Candidates, Plan, PlanError, RiskConfig, Rollouts, search
from oes.mpc.tracking import update_tracks

PUSH = PushConfig(
    oversampling=10,
    length_m=(0.03, 0.06),
    clearance_m=(0.005, 0.015),
    max_offset=0.6,
    max_turn_deg=30.0,
)
SEARCH = PlannerConfig(
    num_candidates=30,
    horizon_steps=1,
    iterations=1,
    num_elites=5,
    goal_bias=0.0,
    heading_std_deg=10.0,
    relative_std=0.2,
    num_reranked=5,
    num_samples=1,
)
ROD = Rod(radius_m=0.008, tip_height_m=0.02, workspace_m=0.3)


def _double_integrator(candidates: Candidates, num_samples: int = 1) -> Rollouts:
    """Positions ST13 of a unit mass at rest at the origin under the actions as accelerations, unit
    time steps.
    """
    velocity = candidates.actions_ST3.cumsum(dim=1)
    return _moved(velocity.cumsum(dim=1)[:, :, None])


def _moved(position_STN3: Tensor) -> Rollouts:
    samples, horizon = position_STN3.shape[:2]
    return Rollouts(
        torch.zeros(samples, horizon + 1, 3),
        position_STN3,
        torch.eye(3).expand(*position_STN3.shape, 3),
    )


def _at_the_end(goal_3: Tensor) -> Callable[[Rollouts], Tensor]:
    """Distance from the goal after the last step; stopping earlier is infinitely costly."""

    def cost(rollouts: Rollouts) -> Tensor:
        distance_ST = (rollouts.position_STN3[:, :, 0] - goal_3).norm(dim=-1)
        return torch.cat([torch.full_like(distance_ST[:, 1:], torch.inf), distance_ST[:, -1:]], 1)

    return cost


def _given(actions_ST3: Tensor) -> Candidates:
    return Candidates(actions_ST3[:, 0], actions_ST3, actions_ST3[..., 0])


def _along_x(goal: float, actions_ST3: Tensor) -> Plan:
    return search(
        lambda _: _given(actions_ST3),
        _double_integrator,
        _at_the_end(torch.tensor([goal, 0.0, 0.0])),
    )


class Gaussian:
    """Accelerations along x: standard normal, then Gaussian with the mean and std of the elites."""

    def __init__(self, count: int, seed: int) -> None:
        self.count, self.generator = count, torch.Generator().manual_seed(seed)

    def __call__(self, elites_SC: Tensor | None) -> Candidates:
        sampled = torch.randn(self.count, 3, generator=self.generator)
        if elites_SC is not None:
            sampled = elites_SC.mean(0) + elites_SC.std(0) * sampled
        actions = torch.zeros(self.count, 3, 3)
        actions[..., 0] = sampled.clamp(-1, 1)
        return _given(actions)


def test_double_integrator_reaches_the_closed_form_optimum() -> None:
    """With |a| <= 1 for 3 steps, x = 3 a0 + 2 a1 + a2 reaches 6 at most, by a = (1, 1, 1); within
    6, distance 0.
    """
    actions = torch.zeros(20000, 3, 3)
    actions[..., 0] = torch.rand(20000, 3, generator=torch.Generator().manual_seed(0)) * 2 - 1
    beyond = _along_x(9.0, actions)
    assert beyond.cost == pytest.approx(3.0, abs=0.25)
    assert (beyond.actions_T3[:, 0] > 0.8).all()
    assert _along_x(2.0, actions).cost < 0.01


def test_cem_beats_random_shooting_with_as_many_plans() -> None:
    """90 plans of the double integrator in three iterations and in one, 20 seeds."""
    cost = _at_the_end(torch.tensor([2.7, 0.0, 0.0]))
    rounds = [search(Gaussian(30, seed), _double_integrator, cost, 3, 5).cost for seed in range(20)]
    once = [search(Gaussian(90, seed), _double_integrator, cost).cost for seed in range(20)]
    assert np.mean(rounds) < 0.5 * np.mean(once)


def test_the_best_of_all_iterations_is_kept() -> None:
    offers = iter([torch.tensor([[[1.0, 0, 0]]]), torch.tensor([[[5.0, 0, 0]]])])
    best = search(
        lambda _: _given(next(offers)),
        lambda p, _: _moved(p.actions_ST3[:, :, None]),
        _at_the_end(torch.zeros(3)),
        2,
    )
    assert best.cost == 1.0 and best.actions_T3.tolist() == [[1.0, 0, 0]]


def test_point_mass_picks_the_nearest_candidate_for_every_goal() -> None:
    actions = torch.randn(50, 1, 3, generator=torch.Generator().manual_seed(1))
    for goal in torch.randn(5, 3, generator=torch.Generator().manual_seed(2)):
        best = search(
            lambda _: _given(actions),
            lambda p, _: _moved(p.actions_ST3[:, :, None]),
            _at_the_end(goal),
        )
        distance = (actions[:, 0] - goal).norm(dim=-1)
        assert best.cost == pytest.approx(float(distance.min()))
        assert torch.equal(best.actions_T3[0], actions[distance.argmin(), 0])
        assert torch.equal(best.position_TN3[0, 0], best.actions_T3[0])


def test_a_plan_is_truncated_after_its_cheapest_step() -> None:
    actions = torch.tensor([[[1.0, 0, 0], [1.0, 0, 0], [1.0, 0, 0]]])
    best = search(
        lambda _: _given(actions),
        lambda p, _: _moved(p.actions_ST3.cumsum(1)[:, :, None]),
        lambda rollouts: (rollouts.position_STN3[:, :, 0, 0] - 2).abs(),
    )
    assert best.cost == 0 and best.actions_T3.shape == (2, 3) and best.position_TN3[-1, 0, 0] == 2


def test_diverged_candidates_are_never_chosen() -> None:
    actions = torch.tensor([[[0.0, 0, 0]], [[1.0, 0, 0]]])
    factor, cost = torch.tensor([torch.nan, 1.0]), _at_the_end(torch.zeros(3))
    best = search(
        lambda _: _given(actions),
        lambda p, _: _moved((p.actions_ST3 * factor[:, None, None])[:, :, None]),
        cost,
    )
    assert best.cost == pytest.approx(1.0)
    with pytest.raises(PlanError, match="no candidate has a finite cost"):
        search(
            lambda _: _given(actions),
            lambda p, _: _moved(p.actions_ST3[:, :, None] * torch.nan),
            cost,
        )


def _windy(candidates: Candidates, num_samples: int) -> Rollouts:
    """A point that follows its actions; in all samples but the first it also drifts sideways, by
    the square of its first action.
    """
    nominal_ST3 = candidates.actions_ST3.cumsum(1)
    wind_MS = (
        torch.linspace(-1, 1, num_samples)[:, None]
        * candidates.actions_ST3[:, 0].norm(dim=-1).square()
    )
    offset_MST3 = torch.zeros(num_samples, *nominal_ST3.shape)
    offset_MST3[1:, ..., 1] = wind_MS[1:, :, None]
    position_ST3 = (nominal_ST3 + offset_MST3).flatten(0, 1)
    return replace(_moved(position_ST3[:, :, None]), num_samples=num_samples)


def test_an_uncertain_plan_costs_more_the_larger_the_risk_weight() -> None:
    bold, timid = [[1.0, 0, 0], [0.0, 0, 0]], [[0.45, 0, 0], [0.45, 0, 0]]
    cost = _at_the_end(torch.tensor([1.0, 0.0, 0.0]))
    plans = {
        risk_weight: search(
            lambda _: _given(torch.tensor([bold, timid])),
            _windy,
            cost,
            risk=RiskConfig(2, 9, risk_weight),
        )
        for risk_weight in (0.0, 1.0)
    }
    once = search(lambda _: _given(torch.tensor([bold, timid])), _windy, cost)
    assert once.actions_T3.tolist() == bold, "the nominal rollout reaches the goal"
    assert all(plan.actions_T3.tolist() == torch.tensor(timid).tolist() for plan in plans.values())
    assert plans[1.0].cost > plans[0.0].cost > 0.1


def test_only_the_cheapest_plans_are_reranked_and_only_up_to_their_cheapest_step() -> None:
    calls: list[tuple[Candidates, int]] = []

    def unroll(candidates: Candidates, num_samples: int) -> Rollouts:
        calls.append((candidates, num_samples))
        return _windy(candidates, num_samples)

    actions = torch.zeros(20, 3, 3)
    actions[:, 0, 0], actions[:, 1, 0], actions[:, 2, 0] = torch.linspace(0, 1, 20), 0.5, 5.0
    best = search(
        lambda _: _given(actions),
        unroll,
        lambda i: (i.position_STN3[:, :, 0, 0] - 1).abs(),
        1,
        2,
        RiskConfig(3, 4, 0.5),
    )
    assert [(len(candidates.tip_S3), num_samples) for candidates, num_samples in calls] == [
        (20, 1),
        (3, 4),
    ]
    reranked_ST = calls[1][0].actions_ST3[..., 0]
    assert reranked_ST[:, 1].tolist() == [0.5, 0.5, 0.5] and (reranked_ST[:, 0] >= 0.4).all(), (
        "two of the three actions"
    )
    assert best.actions_T3[:, 0].tolist() == [1.0], "later steps are not rolled out again"
    with pytest.raises(ValueError, match="num_reranked must be at least num_elites"):
        replace(SEARCH, num_elites=SEARCH.num_reranked + 1)


def _square(center: tuple[float, float], half_cells: int) -> Footprint:
    occupancy = np.zeros((16, 16, 16), np.float32)
    inside = slice(8 - half_cells, 8 + half_cells)
    occupancy[inside, inside, 6:10] = 0.9
    size = np.full(3, half_cells * 0.02)
    return object_footprint(np.array([*center, 0.03]), size, occupancy, voxel_m=0.01, threshold=0.5)


def _gap(
    points_P2: NDArray[np.float64], center: tuple[float, float], half_m: float
) -> NDArray[np.float64]:
    """Distance from points to a square."""
    return np.hypot(*np.maximum(np.abs(points_P2 - np.array(center)) - half_m, 0).T)


def _sample(
    shapes: list[Footprint], cfg: PlannerConfig = SEARCH, push: PushConfig = PUSH
) -> Candidates:
    sampler = PushSampler(PlanningScene(shapes, [], ROD, 0.3), push, np.random.default_rng(0))
    return sampler(cfg, np.zeros(len(shapes)), None)


def test_pushes_head_for_the_goal_and_then_stay_near_the_elites() -> None:
    scene = PlanningScene([_square((0.0, 0.0), 3)], [_square((0.3, 0.3), 3)], ROD, 0.4)
    sampler = PushSampler(scene, PUSH, np.random.default_rng(0))
    toward = sampler(replace(SEARCH, goal_bias=1.0), np.array([0.7]), None)
    heading = torch.atan2(toward.actions_ST3[:, 0, 1], toward.actions_ST3[:, 0, 0])
    assert heading.mean() == pytest.approx(0.7, abs=0.1) and 0.1 < heading.std() < 0.25
    elites = toward.params_SC[:2]
    again = sampler(SEARCH, np.array([0.7]), elites)
    assert torch.equal(again.params_SC[:2], elites) and torch.equal(
        again.tip_S3[:2], toward.tip_S3[:2]
    )
    assert (again.params_SC[:, None, 1] - elites[:, 1]).abs().amin(1).max() < 0.7
    assert len(again.tip_S3) == SEARCH.num_candidates and again.params_SC[:, 1].std() > 0.05


def test_starts_are_beside_their_object_and_clear_of_every_other() -> None:
    centers = [(0.0, 0.0), (0.09, 0.0)]
    candidates = _sample([_square(center, 3) for center in centers])
    object_i = candidates.params_SC[:, 0].numpy().astype(int)
    tip = candidates.tip_S3.numpy().astype(float)
    assert len(tip) == 30 and set(object_i) == {0, 1} and tip[:, 2] == pytest.approx(0.02)
    gaps = np.stack([_gap(tip[:, :2], center, 0.03) for center in centers], axis=1)
    assert gaps.min() >= ROD.radius_m + PUSH.clearance_m[0] - 1e-3, (
        "a rod starts inside an object's clearance"
    )
    own = gaps[np.arange(30), object_i]
    assert own.max() <= ROD.radius_m + PUSH.clearance_m[1] + 0.003, (
        "a start is not beside its object"
    )
    assert own.max() - own.min() > 0.005, "clearances do not vary"


def test_pushes_hit_their_object_with_lengths_in_range() -> None:
    candidates = _sample(
        [_square((0.05, -0.05), 2)], replace(SEARCH, horizon_steps=4), replace(PUSH, max_offset=0.9)
    )
    actions, tip = candidates.actions_ST3.numpy(), candidates.tip_S3.numpy()
    length = np.linalg.norm(actions, axis=-1)
    assert actions.shape == (30, 4, 3) and (actions[..., 2] == 0).all()
    assert length.min() >= 0.03 - 1e-6 and length.max() <= 0.06 + 1e-6 and length.std() > 0.004
    fraction = np.linspace(0, 1, 50)[:, None, None]
    swept = tip[None, :, :2] + fraction * actions[None, :, 0, :2]
    closest = _gap(swept.reshape(-1, 2), (0.05, -0.05), 0.02).reshape(50, 30).min(axis=0)
    assert (closest <= ROD.radius_m).all(), "a push misses its object"
    assert np.ptp(np.arctan2(actions[:, 0, 1], actions[:, 0, 0])) > 4, "headings do not vary"


def test_the_rod_stays_within_its_workspace() -> None:
    candidates = _sample([_square((0.24, 0.0), 3)])
    end = candidates.tip_S3 + candidates.actions_ST3.sum(dim=1)
    assert max(candidates.tip_S3.abs().max(), end.abs().max()) <= ROD.workspace_m


def test_empty_mask_falls_back_to_the_box() -> None:
    nothing = np.zeros((16, 16, 16), np.float32)
    shape = object_footprint(
        np.array([0.1, 0.0, 0.02]), np.array([0.08, 0.04, 0.04]), nothing, 0.01, 0.5
    )
    assert np.ptp(shape.points_P2, axis=0) == pytest.approx([0.08, 0.04])


def test_no_free_start_is_an_error() -> None:
    with pytest.raises(NoFreeStart, match="beside 1 objects"):
        _sample([_square((0.5, 0.5), 3)])


def test_assignment_is_joint_gated_and_one_to_one() -> None:
    expected = np.array([[0.0, 0, 0], [0.05, 0, 0]])
    detected = np.array([[0.04, 0, 0], [0.3, 0, 0], [-0.02, 0, 0]])
    assert assign(expected, detected, 0.06).tolist() == [2, 0]
    assert assign(expected, detected[1:2], 0.06).tolist() == [-1, -1]
    assert assign(expected, np.zeros((0, 3)), 0.06).tolist() == [-1, -1]
    assert assign(expected, np.array([[0.03, 0.0, 0.0]]), 0.06).tolist() == [-1, 0]


def test_an_undetected_object_keeps_its_estimate() -> None:
    center, size = np.array([[0.0, 0, 0], [0.2, 0, 0]]), np.full((2, 3), 0.05)
    new_center, new_size, is_detected = update_tracks(
        center, size, np.array([[0.21, 0, 0]]), np.full((1, 3), 0.07), 0.06
    )
    assert is_detected.tolist() == [False, True]
    assert new_center[:, 0].tolist() == [0.0, 0.21] and new_size[:, 0].tolist() == [0.05, 0.07]
    assert center[1, 0] == 0.2, "the caller's arrays are not changed"
