"""The closed loop on the real simulator with a perfect eye and a simple oracle of pushing in the
place of networks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from oes.dynamics.graph import ObjectState, StepMotion
from oes.dynamics.unroll import DynamicsModel
from oes.episode import Camera, Floats, Frames, Step
from oes.meshes.catalogue import Catalogue
from oes.mpc.cost import AvoidConfig
from oes.mpc.sampler import PlannerConfig, PushConfig, Rod
from oes.mpc.search import Candidates
from oes.objects import Objects
from oes.sim.pushing import PushWorld
from oes.sim.scene import ScatterConfig, SceneRejected
from oes.sim.world import SimConfig
from oes.trials.loop import COLLIDED, TrialResult, run_trial
from oes.trials.obstacles import ObstaclesConfig
from oes.trials.planner import Observation, Planner, PlanningConfig, TrackConfig
from oes.trials.task import Task, TrialScenario, draw_task, generator
from oes.trials.world_models import GraphWorldModel, StateEstimate
from tests.blocks import make_catalogue, read_sim

SHOOTING = PlannerConfig(
    num_candidates=60,
    horizon_steps=1,
    iterations=1,
    num_elites=1,
    goal_bias=0.0,
    heading_std_deg=0.0,
    relative_std=0.0,
    num_reranked=6,
    num_samples=8,
)
CEM = PlannerConfig(
    num_candidates=20,
    horizon_steps=1,
    iterations=3,
    num_elites=4,
    goal_bias=0.5,
    heading_std_deg=20.0,
    relative_std=0.3,
    num_reranked=6,
    num_samples=8,
)
TARGETS = TrialScenario(
    num_objects=(1, 2),
    scatter=ScatterConfig(spread_m=0.15, rim_m=0.27, gap_m=0.03),
    goal_m=(0.08, 0.15),
    goal_spread_m=0.17,
    goal_gap_m=0.02,
    obstacles=ObstaclesConfig(count=0, along=(0.4, 0.6), aside_m=0.02, gap_m=0.02),
    max_steps=10,
    success_m=0.04,
    stop_m=0.015,
    settle_ms=200,
    max_attempts=200,
    planners={"shooting": SHOOTING, "cem": CEM},
)
AROUND = replace(
    TARGETS,
    num_objects=(1, 1),
    goal_m=(0.24, 0.3),
    obstacles=replace(TARGETS.obstacles, count=1),
    max_steps=20,
    max_attempts=2000,
)
PLANNING = PlanningConfig(
    push=PushConfig(
        oversampling=4,
        length_m=(0.03, 0.06),
        clearance_m=(0.01, 0.02),
        max_offset=0.3,
        max_turn_deg=0.0,
    ),
    avoid=AvoidConfig(margin_m=0.008, collision_cost_m=1.0),
    track=TrackConfig(gate_m=0.08, unseen_size_m=0.07, mask=0.5),
    risk_weight=0.5,
)


@pytest.fixture(scope="module")
def sim() -> SimConfig:
    return read_sim()


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    return make_catalogue(tmp_path_factory.mktemp("meshes"))


@pytest.fixture
def world(catalogue: Catalogue, sim: SimConfig) -> Iterator[PushWorld]:
    with PushWorld(catalogue, sim, TARGETS.settle_ms) as opened:
        yield opened


class Oracle:
    """Eyes that know the true boxes (``look`` is shown every state), except those of ``blind``
    objects.
    """

    def __init__(self, blind: set[int] = frozenset()) -> None:  # type: ignore[assignment]
        self.blind, self.cameras = blind, list[str]()

    def look(self, step: Step, camera: Camera) -> Observation:
        self.step = step
        self.cameras.append(camera.name)
        shape = (1, camera.height_px, camera.width_px)
        nothing = Frames(
            np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        )
        return Observation(nothing, camera)

    def encode(self, frames: Frames, cameras: Sequence[Camera]) -> Step:
        assert len(cameras) == 1 == len(frames.rgb_VHW3)
        return self.step

    def detect(self, scene: Step) -> tuple[Tensor, Tensor, Tensor]:
        seen = [i for i in range(len(scene.center_N3)) if i not in self.blind][::-1]
        centers, sizes = (
            torch.from_numpy(values[seen]) for values in (scene.center_N3, scene.size_N3)
        )
        return centers, sizes, torch.ones(len(seen))

    def objects(
        self, scene: Step, centers_N3: Tensor, sizes_N3: Tensor, scores_N: Tensor, *_: object
    ) -> Objects:
        count = len(centers_N3)
        return Objects(
            center_N3=centers_N3,
            size_N3=sizes_N3,
            score_N=scores_N,
            valid_N=torch.ones(count, dtype=torch.bool),
            crop_NCXYZ=torch.zeros(count, 1, 16, 16, 16),
            image_NV3HW=torch.zeros(count, 1, 3, 32, 32, dtype=torch.uint8),
            camera_NV12=torch.zeros(count, 1, 12),
            view_NV=torch.ones(count, 1, dtype=torch.bool),
            radial_profile_NRD3=torch.zeros(count, 6, 32, 3),
            com_offset_N3=torch.zeros(count, 3),
        )


class Shove(DynamicsModel):
    """Whatever the rod's path would run into is carried along by the rest of the path."""

    def appearance(self, objects: Objects) -> Tensor:
        return objects.center_N3[..., :0]

    def forward(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        length_B1 = action_B3.norm(dim=-1, keepdim=True)
        forward_B3 = action_B3 / length_B1
        offset_BN3 = (state.center_BN3 - tip_world_B3[:, None]) * torch.tensor([1.0, 1, 0])
        along_BN = (offset_BN3 * forward_B3[:, None]).sum(-1)
        across_BN = (offset_BN3 - along_BN[..., None] * forward_B3[:, None]).norm(dim=-1)
        carried_BN = (
            (length_B1 - (along_BN - 0.043)).clamp(min=0) * (across_BN < 0.035) * (along_BN > 0)
        )
        dp_BN3 = carried_BN[..., None] * forward_B3[:, None]
        return StepMotion(dp_BN3, torch.zeros_like(dp_BN3))


def _planner(sim: SimConfig, eyes: Oracle) -> Planner[Step]:
    rod = Rod(sim.robot.rod_radius_m, sim.robot.tip_height_m, sim.robot.workspace_m)
    return Planner(eyes, 0.01, GraphWorldModel(Shove()), rod, 0.3, PLANNING)


def _run(
    world: PushWorld,
    sim: SimConfig,
    eyes: Oracle,
    task: Task,
    trial_i: int,
    cfg: TrialScenario = TARGETS,
    search: PlannerConfig = SHOOTING,
) -> TrialResult:
    rngs = (generator(0, "targets", trial_i, 1), generator(0, "targets", trial_i, 2))
    return run_trial(world, eyes.look, _planner(sim, eyes), task, cfg, search, rngs)


def _task(
    catalogue: Catalogue,
    sim: SimConfig,
    trial_i: int,
    num_objects: int,
    base: TrialScenario = TARGETS,
) -> Task:
    cfg = replace(base, num_objects=(num_objects, num_objects))
    return draw_task(catalogue, sim, cfg, generator(0, "targets", trial_i, 0))


def test_an_oracle_pushes_objects_to_their_goals(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    """Every step costs Bullet time, so only three trials: one object, two objects, and their
    records.
    """
    outcomes = [
        _run(world, sim, Oracle(), _task(catalogue, sim, i, n), i) for i, n in enumerate((1, 1, 2))
    ]
    for outcome in outcomes:
        assert outcome.failure == ""
        assert (outcome.initial_G > 0.07).all()
        assert outcome.final_G.mean() < 0.5 * outcome.initial_G.mean()
        assert outcome.believed_G == pytest.approx(outcome.final_G, abs=1e-6), (
            "a perfect eye believes the truth"
        )
        assert len(outcome.moments) == outcome.steps_used + 1
        assert outcome.moments[-1].chosen is None
    assert sum(outcome.final_G.mean() < TARGETS.success_m for outcome in outcomes) >= 2
    assert any(outcome.steps_used < TARGETS.max_steps for outcome in outcomes), (
        "no trial stopped by itself"
    )


def test_same_seed_same_trial_and_one_random_camera_a_step(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task, short = _task(catalogue, sim, 7, 2), replace(TARGETS, max_steps=2)
    eyes = [Oracle(), Oracle()]
    first, again = (_run(world, sim, eye, task, 7, short) for eye in eyes)
    assert np.array_equal(first.final_G, again.final_G) and first.steps_used == again.steps_used
    assert eyes[0].cameras == eyes[1].cameras and len(set(eyes[0].cameras)) > 1
    assert not np.array_equal(
        first.moments[0].camera.world_T_cam_44, first.moments[1].camera.world_T_cam_44
    )


def test_an_object_never_seen_stays_where_it_was_said_to_be(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task = _task(catalogue, sim, 3, 2)
    outcome = _run(world, sim, Oracle(blind={1}), task, 3, replace(TARGETS, max_steps=1))
    first = outcome.moments[0].belief
    assert first.is_seen_N.tolist() == [True, False]
    assert first.center_N3[1] == pytest.approx(task.center_N3[1])
    assert first.size_N3[1] == pytest.approx(PLANNING.track.unseen_size_m)
    assert first.size_N3[0] != pytest.approx(PLANNING.track.unseen_size_m)


def test_an_object_off_the_table_ends_the_trial(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task = _task(catalogue, sim, 0, 1)
    over_the_rim = task.world_T_obj_N44.copy()
    over_the_rim[0, :2, 3] = [0.32, 0.0]
    outcome = _run(world, sim, Oracle(), replace(task, world_T_obj_N44=over_the_rim), 0)
    assert outcome.failure == "an object fell off the table"
    assert outcome.steps_used == 0 and [moment.chosen for moment in outcome.moments] == [None]


def test_nothing_to_propose_breaks_the_trial_off_with_its_reason(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task = _task(catalogue, sim, 0, 1)
    planner = _planner(sim, Oracle())
    planner.rod = replace(planner.rod, workspace_m=0.01)
    rngs = (generator(0, "targets", 0, 1), generator(0, "targets", 0, 2))
    outcome = run_trial(world, planner.eyes.look, planner, task, TARGETS, SHOOTING, rngs)  # type: ignore[attr-defined]
    assert "is free" in outcome.failure and outcome.steps_used == 0
    assert outcome.final_G == pytest.approx(outcome.initial_G)


def test_an_oracle_pushes_around_an_obstacle(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    """Two trials with the cross-entropy method: at least one ends at the goal; what touches the
    obstacle ends there.
    """
    outcomes = [
        _run(world, sim, Oracle(), _task(catalogue, sim, i, 1, AROUND), i, AROUND, CEM)
        for i in range(2)
    ]
    arrived = [o for o in outcomes if not o.failure and o.final_G.mean() < AROUND.success_m]
    assert arrived
    assert all(
        len(outcome.final_G) == 1 and len(outcome.moments[0].belief.center_N3) == 2
        for outcome in outcomes
    )
    path = np.array([moment.belief.center_N3 for moment in arrived[0].moments])
    assert np.ptp(path[:, 1], axis=0) == pytest.approx(0, abs=1e-3), "the obstacle did not move"


def test_a_touched_obstacle_ends_the_trial(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    """A planner that does not care about the obstacle runs into it."""
    task = _task(catalogue, sim, 1, 1, AROUND)
    planner = _planner(sim, Oracle())
    planner.cfg = replace(PLANNING, avoid=AvoidConfig(margin_m=-1.0, collision_cost_m=0.0))
    rngs = (generator(0, "targets", 1, 1), generator(0, "targets", 1, 2))
    outcome = run_trial(world, planner.eyes.look, planner, task, AROUND, CEM, rngs)  # type: ignore[attr-defined]
    assert outcome.failure == COLLIDED and 0 < outcome.steps_used < AROUND.max_steps
    assert len(outcome.moments) == outcome.steps_used + 1, "the film ends with what happened"


def test_obstacles_bar_every_straight_way_and_leave_another(
    catalogue: Catalogue, sim: SimConfig
) -> None:
    for count in (1, 2, 3):
        cfg = replace(AROUND, obstacles=replace(AROUND.obstacles, count=count))
        for trial_i in range(6):
            task = _task(catalogue, sim, trial_i, 1, cfg)
            assert len(task.bodies) == 1 + count and task.goal_G3.shape == (1, 3)
            start, goal, obstacle = (
                task.center_N3[0, :2],
                task.goal_G3[0, :2],
                task.center_N3[1, :2],
            )
            along = (goal - start) / np.linalg.norm(goal - start)
            offset = obstacle - start
            assert abs(offset[0] * along[1] - offset[1] * along[0]) < 0.06
            assert 0.3 < offset @ along / np.linalg.norm(goal - start) < 0.7
            apart = np.linalg.norm(task.center_N3[1:, None, :2] - np.stack([start, goal]), axis=-1)
            assert apart.min() > 0.06
    with pytest.raises(SceneRejected, match="in 3 attempts"):
        _task(catalogue, sim, 0, 1, replace(AROUND, max_attempts=3, goal_m=(0.05, 0.06)))


def test_tasks_keep_the_rules(catalogue: Catalogue, sim: SimConfig) -> None:
    counts = set()
    for trial_i in range(40):
        task = draw_task(catalogue, sim, TARGETS, generator(0, "targets", trial_i, 0))
        distance = np.linalg.norm(task.goal_G3 - task.center_N3, axis=1)
        assert distance.min() >= TARGETS.goal_m[0] and distance.max() <= TARGETS.goal_m[1]
        assert np.abs(task.goal_G3[:, :2]).max() <= TARGETS.goal_spread_m
        assert task.goal_G3[:, 2] == pytest.approx(task.center_N3[:, 2])
        counts.add(len(task.bodies))
        if len(task.bodies) == 2:
            assert np.linalg.norm(task.goal_G3[0] - task.goal_G3[1]) > 0.08
    assert counts == {1, 2}
    same, other = (
        draw_task(catalogue, sim, TARGETS, generator(0, "targets", i, 0)).goal_G3 for i in (39, 38)
    )
    assert np.array_equal(task.goal_G3, same) and not np.array_equal(same, other)


def test_imagining_reads_appearance_once_and_moves_what_is_in_the_way() -> None:
    objects = Oracle().objects(
        None,
        torch.tensor([[0.1, 0.0, 0.02], [0.0, 0.2, 0.02]]),
        torch.full((2, 3), 0.07),
        torch.ones(2),
    )  # type: ignore[arg-type]
    tips: Floats = np.array([[0.04, 0.0, 0.02], [0.0, 0.1, 0.02]])
    proposals = Candidates(
        torch.from_numpy(tips).float(),
        torch.tensor([[[0.05, 0, 0]], [[0, 0.05, 0]]]),
        torch.zeros(2, 0),
    )
    belief = StateEstimate(
        objects, objects.center_N3.numpy(), objects.size_N3.numpy(), np.ones(2, dtype=bool), None
    )
    imagined = GraphWorldModel(Shove()).imagine(belief, np.zeros((2, 3)), proposals)
    positions = imagined.position_STN3
    assert imagined.tip_SI3[:, 1].tolist() == [
        pytest.approx([0.09, 0, 0.02]),
        pytest.approx([0, 0.15, 0.02]),
    ]
    assert positions.shape == (2, 1, 2, 3)
    assert positions[0, 0, 0].tolist() == pytest.approx([0.1 + 0.05 - 0.017, 0.0, 0.02])
    assert positions[0, 0, 1].tolist() == pytest.approx([0.0, 0.2, 0.02])
    assert positions[1, 0, 0].tolist() == pytest.approx([0.1, 0.0, 0.02])
