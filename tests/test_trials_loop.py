"""The closed loop in the real simulator, with oracles for perception and dynamics."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from oes.dynamics.graph import ObjectState, StepMotion, TipMotion
from oes.dynamics.unroll import DynamicsModel
from oes.episode import Camera, Floats, Frames, Step
from oes.meshes.catalogue import Catalogue
from oes.mpc.cost import AvoidConfig
from oes.mpc.sampler import PlannerConfig, PushConfig
from oes.mpc.scene import Rod
from oes.mpc.search import Candidates
from oes.objects import Objects
from oes.sim.pushing import PushWorld
from oes.sim.scene import ScatterConfig, SceneRejected
from oes.sim.world import SimConfig
from oes.trials.loop import COLLIDED, TrialResult, run_trial
from oes.trials.planner import CameraObservation, Planner, PlanningConfig, TrackConfig
from oes.trials.task import ObstaclesConfig, Task, TrialScenario, draw_task, generator
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
    scatter=ScatterConfig(spread_m=0.15, table_edge_m=0.27, gap_m=0.03),
    goal_distance_m=(0.08, 0.15),
    goal_spread_m=0.17,
    goal_gap_m=0.02,
    obstacles=ObstaclesConfig(count=0, path_fraction=(0.4, 0.6), lateral_m=0.02, gap_m=0.02),
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
    goal_distance_m=(0.24, 0.3),
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
    track=TrackConfig(gate_m=0.08, unseen_size_m=0.07, mask_threshold=0.5),
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
    """Sensor and perception that report true boxes, except those of ``undetected`` objects."""

    def __init__(self, undetected: set[int] = frozenset()) -> None:  # type: ignore[assignment]
        self.undetected, self.cameras = undetected, list[str]()

    def render(self, step: Step, camera: Camera) -> CameraObservation:
        self.step = step
        self.cameras.append(camera.name)
        shape = (1, camera.height_px, camera.width_px)
        frames = Frames(
            np.zeros((*shape, 3), np.uint8), np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        )
        return CameraObservation(frames, camera)

    def encode(self, frames: Frames, cameras: Sequence[Camera]) -> Step:
        assert len(cameras) == 1 == len(frames.rgb_VHW3)
        return self.step

    def detect(self, scene: Step) -> tuple[Tensor, Tensor, Tensor]:
        detected = [i for i in range(len(scene.center_N3)) if i not in self.undetected][::-1]
        centers, sizes = (
            torch.from_numpy(values[detected]) for values in (scene.center_N3, scene.size_N3)
        )
        return centers, sizes, torch.ones(len(detected))

    def objects(
        self, scene: Step | None, boxes: tuple[Tensor, Tensor, Tensor], *_: object
    ) -> Objects:
        count = len(boxes[0])
        return Objects(
            center_N3=boxes[0],
            size_N3=boxes[1],
            score_N=boxes[2],
            valid_N=torch.ones(count, dtype=torch.bool),
            crop_NCXYZ=torch.zeros(count, 1, 16, 16, 16),
            image_NV3HW=torch.zeros(count, 1, 3, 32, 32, dtype=torch.uint8),
            camera_NV12=torch.zeros(count, 1, 12),
            view_NV=torch.ones(count, 1, dtype=torch.bool),
            radial_profile_NRD3=torch.zeros(count, 6, 32, 3),
            com_offset_N3=torch.zeros(count, 3),
        )


class RodMotion(DynamicsModel):
    """Objects in the path of the rod move with it from the first contact."""

    def appearance(self, objects: Objects) -> Tensor:
        return objects.center_N3[..., :0]

    def forward(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        length_B1 = tip.action_B3.norm(dim=-1, keepdim=True)
        forward_B3 = tip.action_B3 / length_B1
        offset_BN3 = (state.center_BN3 - tip.start_B3[:, None]) * torch.tensor([1.0, 1, 0])
        along_BN = (offset_BN3 * forward_B3[:, None]).sum(-1)
        across_BN = (offset_BN3 - along_BN[..., None] * forward_B3[:, None]).norm(dim=-1)
        pushed_BN = (
            (length_B1 - (along_BN - 0.043)).clamp(min=0) * (across_BN < 0.035) * (along_BN > 0)
        )
        dp_BN3 = pushed_BN[..., None] * forward_B3[:, None]
        return StepMotion(dp_BN3, torch.zeros_like(dp_BN3))


def _planner(sim: SimConfig, perception: Oracle) -> Planner:
    rod = Rod(sim.robot.rod_radius_m, sim.robot.tip_height_m, sim.robot.workspace_m)
    return Planner(perception, 0.01, GraphWorldModel(RodMotion()), rod, 0.3, PLANNING)


def _run(
    world: PushWorld,
    sim: SimConfig,
    perception: Oracle,
    task: Task,
    trial_i: int,
    cfg: TrialScenario = TARGETS,
    search: PlannerConfig = SHOOTING,
) -> TrialResult:
    rngs = (generator(0, "targets", trial_i, 1), generator(0, "targets", trial_i, 2))
    return run_trial(world, perception.render, _planner(sim, perception), task, cfg, search, rngs)


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
    """Three trials only, since every step costs simulation time."""
    results = [
        _run(world, sim, Oracle(), _task(catalogue, sim, i, n), i) for i, n in enumerate((1, 1, 2))
    ]
    for result in results:
        assert result.failure == ""
        assert (result.initial_G > 0.07).all()
        assert result.final_G.mean() < 0.5 * result.initial_G.mean()
        assert result.estimated_G == pytest.approx(result.final_G, abs=1e-6), (
            "the estimate is the ground truth"
        )
        assert len(result.steps) == result.steps_used + 1
        assert result.steps[-1].plan is None
    assert sum(result.final_G.mean() < TARGETS.success_m for result in results) >= 2
    assert any(result.steps_used < TARGETS.max_steps for result in results), (
        "no trial stopped by itself"
    )


def test_a_trial_repeats_with_its_seed_and_samples_a_camera_per_step(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task, short = _task(catalogue, sim, 7, 2), replace(TARGETS, max_steps=2)
    oracles = [Oracle(), Oracle()]
    first, again = (_run(world, sim, oracle, task, 7, short) for oracle in oracles)
    assert np.array_equal(first.final_G, again.final_G) and first.steps_used == again.steps_used
    assert oracles[0].cameras == oracles[1].cameras and len(set(oracles[0].cameras)) > 1
    assert not np.array_equal(
        first.steps[0].camera.world_T_cam_44, first.steps[1].camera.world_T_cam_44
    )


def test_an_undetected_object_keeps_its_initial_position(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task = _task(catalogue, sim, 3, 2)
    result = _run(world, sim, Oracle(undetected={1}), task, 3, replace(TARGETS, max_steps=1))
    first = result.steps[0].estimate
    assert first.is_detected_N.tolist() == [True, False]
    assert first.center_N3[1] == pytest.approx(task.center_N3[1])
    assert first.size_N3[1] == pytest.approx(PLANNING.track.unseen_size_m)
    assert first.size_N3[0] != pytest.approx(PLANNING.track.unseen_size_m)


def test_an_object_off_the_table_ends_the_trial(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task = _task(catalogue, sim, 0, 1)
    poses_N44 = task.world_T_obj_N44.copy()
    poses_N44[0, :2, 3] = [0.32, 0.0]
    result = _run(world, sim, Oracle(), replace(task, world_T_obj_N44=poses_N44), 0)
    assert result.failure == "an object fell off the table"
    assert result.steps_used == 0 and [record.plan for record in result.steps] == [None]


def test_a_trial_without_a_feasible_push_ends_with_its_reason(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    task = _task(catalogue, sim, 0, 1)
    planner = _planner(sim, Oracle())
    planner.rod = replace(planner.rod, workspace_m=0.01)
    rngs = (generator(0, "targets", 0, 1), generator(0, "targets", 0, 2))
    render = planner.perceiver.render  # type: ignore[attr-defined]
    result = run_trial(world, render, planner, task, TARGETS, SHOOTING, rngs)
    assert "is free" in result.failure and result.steps_used == 0
    assert result.final_G == pytest.approx(result.initial_G)


def test_an_oracle_pushes_around_an_obstacle(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    """Two trials with CEM: at least one reaches the goal."""
    results = [
        _run(world, sim, Oracle(), _task(catalogue, sim, i, 1, AROUND), i, AROUND, CEM)
        for i in range(2)
    ]
    successes = [r for r in results if not r.failure and r.final_G.mean() < AROUND.success_m]
    assert successes
    assert all(
        len(result.final_G) == 1 and len(result.steps[0].estimate.center_N3) == 2
        for result in results
    )
    path = np.array([record.estimate.center_N3 for record in successes[0].steps])
    assert np.ptp(path[:, 1], axis=0) == pytest.approx(0, abs=1e-3), "the obstacle did not move"


def test_a_collision_with_an_obstacle_ends_the_trial(
    catalogue: Catalogue, sim: SimConfig, world: PushWorld
) -> None:
    """A planner without a collision cost runs into the obstacle."""
    task = _task(catalogue, sim, 1, 1, AROUND)
    planner = _planner(sim, Oracle())
    planner.cfg = replace(PLANNING, avoid=AvoidConfig(margin_m=-1.0, collision_cost_m=0.0))
    rngs = (generator(0, "targets", 1, 1), generator(0, "targets", 1, 2))
    render = planner.perceiver.render  # type: ignore[attr-defined]
    result = run_trial(world, render, planner, task, AROUND, CEM, rngs)
    assert result.failure == COLLIDED and 0 < result.steps_used < AROUND.max_steps
    assert len(result.steps) == result.steps_used + 1, "the last record shows the collision"


def test_obstacles_block_the_straight_path_and_leave_another(
    catalogue: Catalogue, sim: SimConfig
) -> None:
    for count in (1, 2, 3):
        cfg = replace(AROUND, obstacles=replace(AROUND.obstacles, count=count))
        for trial_i in range(6):
            task = _task(catalogue, sim, trial_i, 1, cfg)
            assert len(task.bodies) == 1 + count and task.goal_G3.shape == (1, 3)
            (start, obstacle), goal = task.center_N3[:2, :2], task.goal_G3[0, :2]
            along = (goal - start) / np.linalg.norm(goal - start)
            offset = obstacle - start
            assert abs(offset[0] * along[1] - offset[1] * along[0]) < 0.06
            assert 0.3 < offset @ along / np.linalg.norm(goal - start) < 0.7
            apart = np.linalg.norm(task.center_N3[1:, None, :2] - np.stack([start, goal]), axis=-1)
            assert apart.min() > 0.06
    with pytest.raises(SceneRejected, match="in 3 attempts"):
        _task(catalogue, sim, 0, 1, replace(AROUND, max_attempts=3, goal_distance_m=(0.05, 0.06)))


def test_tasks_satisfy_their_scenario(catalogue: Catalogue, sim: SimConfig) -> None:
    counts = set()
    for trial_i in range(40):
        task = draw_task(catalogue, sim, TARGETS, generator(0, "targets", trial_i, 0))
        distance = np.linalg.norm(task.goal_G3 - task.center_N3, axis=1)
        assert (
            distance.min() >= TARGETS.goal_distance_m[0]
            and distance.max() <= TARGETS.goal_distance_m[1]
        )
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


def test_graph_world_model_predicts_the_motion_of_pushed_objects() -> None:
    centers = torch.tensor([[0.1, 0.0, 0.02], [0.0, 0.2, 0.02]])
    objects = Oracle().objects(None, (centers, torch.full((2, 3), 0.07), torch.ones(2)))
    tips: Floats = np.array([[0.04, 0.0, 0.02], [0.0, 0.1, 0.02]])
    candidates = Candidates(
        torch.from_numpy(tips).float(),
        torch.tensor([[[0.05, 0, 0]], [[0, 0.05, 0]]]),
        torch.zeros(2, 0),
    )
    estimate = StateEstimate(
        objects, objects.center_N3.numpy(), objects.size_N3.numpy(), np.ones(2, dtype=bool), None
    )
    rollouts = GraphWorldModel(RodMotion()).predict(estimate, np.zeros((2, 3)), candidates)
    positions = rollouts.position_STN3
    assert rollouts.tip_SI3[:, 1].tolist() == [
        pytest.approx([0.09, 0, 0.02]),
        pytest.approx([0, 0.15, 0.02]),
    ]
    assert positions.shape == (2, 1, 2, 3)
    assert positions[0, 0, 0].tolist() == pytest.approx([0.1 + 0.05 - 0.017, 0.0, 0.02])
    assert positions[0, 0, 1].tolist() == pytest.approx([0.0, 0.2, 0.02])
    assert positions[1, 0, 0].tolist() == pytest.approx([0.1, 0.0, 0.02])
