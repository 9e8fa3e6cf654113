"""One push planned and executed on a novel object: forecast and execution side by side in demo.mp4.

``python -m oes.apps.demo`` needs no dataset: it uses the weights in git and makes a small catalogue
of meshes if there is none.
"""

import logging
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from oes.apps.assets import DATASETS, KEPT, find_catalogue, find_weights
from oes.cli import run
from oes.config import PARAMS, load, params
from oes.episode import Body, Floats, Step
from oes.meshes.catalogue import Catalogue
from oes.mpc.search import Plan
from oes.perception.perceiver import Perceiver
from oes.sim.rig import rig
from oes.sim.world import SimConfig, World
from oes.trials.loop import StepRecord, TrialResult, run_trial
from oes.trials.runner import (
    CAMERA_STREAM,
    PLAN_STREAM,
    TASK_STREAM,
    CameraSensor,
    TrialsConfig,
    make_planner,
)
from oes.trials.task import Task, TrialScenario, draw_task, generator
from oes.trials.trial_video import observed_image
from oes.trials.world_models import load_world_model
from oes.viz.overlay import FORECAST, GOAL, PUSH, CameraOverlay
from oes.viz.video import write_video

log = logging.getLogger(__name__)

SCENARIO, PLANNER, MODEL = "targets", "cem", "oes"
DEMO_FILE = Path("demo.mp4")


@params
class DemoConfig:
    """The section ``demo``: the goal's distance, video frames per push, and the video's format."""

    seed: int
    goal_m: tuple[float, float]
    frames_per_push: int
    zoom: int
    fps: int
    hold_s: float


def main(cfg: DemoConfig) -> None:
    """Plan and push until the estimated position reaches the goal, and write the video.

    Raises WeightsMissing.
    """
    trials = load(PARAMS, "trials", TrialsConfig)
    scenario = replace(trials.scenarios[SCENARIO], num_objects=(1, 1), goal_distance_m=cfg.goal_m)
    perception, dynamics = find_weights((KEPT, DATASETS), (MODEL,))
    catalogue = find_catalogue()
    planner = make_planner(trials, Perceiver.load(perception), load_world_model(dynamics[MODEL]))
    rngs = [
        generator(cfg.seed, "demo", 0, stream)
        for stream in (TASK_STREAM, CAMERA_STREAM, PLAN_STREAM)
    ]
    task = draw_task(catalogue, trials.sim, scenario, rngs[TASK_STREAM])
    sensor = CameraSensor(catalogue, trials.sim, task.bodies)
    with SteppedPushWorld(catalogue, trials.sim, scenario.settle_ms, cfg.frames_per_push) as world:
        search = scenario.planners[PLANNER]
        result = run_trial(
            world, sensor, planner, task, scenario, search, (rngs[CAMERA_STREAM], rngs[PLAN_STREAM])
        )
        write_video(
            video_frames(result, world.pushes, sensor, task, scenario, cfg), DEMO_FILE, cfg.fps
        )
    start_mm, end_mm = result.initial_G.mean() * 1e3, result.final_G.mean() * 1e3
    distances = f"{start_mm:.0f} mm from the goal at the start, {end_mm:.0f} mm"
    log.info("%s: %s after %d pushes", DEMO_FILE, distances, result.steps_used)


def video_frames(
    result: TrialResult,
    pushes: Sequence[Sequence[Step]],
    sensor: CameraSensor,
    task: Task,
    scenario: TrialScenario,
    cfg: DemoConfig,
) -> Iterator[NDArray[np.uint8]]:
    """Left the planner's observation and forecast, right the execution, from the same camera."""
    hold = round(cfg.hold_s * cfg.fps)
    done = iter(pushes)
    for record in result.steps:
        before = _beside(record, 0.0, record.rgb_HW3, task, scenario, cfg)
        yield from [before] * hold
        if record.plan is None:
            continue
        states = next(done)
        for state_i, state in enumerate(states):
            rgb_HW3 = sensor(state, record.camera).frames.rgb_VHW3[0]
            yield _beside(
                record, min(1.0, state_i / cfg.frames_per_push), rgb_HW3, task, scenario, cfg
            )
        yield from [_beside(record, 1.0, rgb_HW3, task, scenario, cfg)] * hold


def _beside(
    record: StepRecord,
    share: float,
    rgb_HW3: NDArray[np.uint8],
    task: Task,
    scenario: TrialScenario,
    cfg: DemoConfig,
) -> NDArray[np.uint8]:
    """The forecast (after ``share`` of the push) and the execution, side by side."""
    imagined = observed_image(record, task.goal_G3, scenario.success_m, cfg.zoom)
    imagined.label("forecast" if record.plan else "observed")
    if record.plan is not None:
        _draw_forecast(
            imagined, record.plan, record.estimate.center_N3, record.estimate.size_N3, share
        )
    real = CameraOverlay(rgb_HW3, record.camera, cfg.zoom)
    for goal in task.goal_G3:
        real.ring(goal * [1, 1, 0], scenario.success_m, GOAL)
    real.label("executed")
    return np.concatenate([imagined.pixels, real.pixels], axis=1)


def _draw_forecast(
    picture: CameraOverlay, chosen: Plan, center_N3: Floats, size_N3: Floats, share: float
) -> None:
    """Draw the rod and the boxes after ``share`` of the push, interpolated linearly."""
    tip, action = chosen.tip_3.double().numpy(), chosen.actions_T3[0].double().numpy()
    picture.arrow(tip, action, PUSH)
    picture.line(np.stack([tip + share * action, tip + share * action + [0, 0, 0.15]]), PUSH)
    for start, end, size in zip(
        center_N3, chosen.position_TN3[0].double().numpy(), size_N3, strict=True
    ):
        picture.box(start + share * (end - start), size, FORECAST)


class SteppedPushWorld:
    """A PushWorld that records the states during every push: ``pushes[i]``, from start to rest."""

    def __init__(
        self, catalogue: Catalogue, sim: SimConfig, settle_ms: int, states_per_push: int
    ) -> None:
        """Raises ValueError unless a timestep divides into states of whole physics steps."""
        timestep_ms = sim.physics.timestep_ms // states_per_push
        slow = replace(sim, physics=replace(sim.physics, timestep_ms=timestep_ms))
        self._world, self._sim = World(catalogue, slow), sim
        self._settle_ms, self._parts = settle_ms, states_per_push
        self.pushes: list[list[Step]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: Any) -> None:
        self._world.__exit__(*error)

    def reset(self, bodies: Sequence[Body], world_T_obj_N44: Floats, tip_xy_m: Floats) -> None:
        """Set the scene and let it settle."""
        self._world.reset(bodies, world_T_obj_N44, self._tip(tip_xy_m))
        self._world.run(self._settle_ms)

    def push(self, tip_start_xy_m: Floats, action_3: Floats, rng: np.random.Generator) -> Step:
        """One push in equal parts at the same speed, then rest."""
        self._world.arm.reset_to(self._tip(tip_start_xy_m))
        states = [self._world.step(0, ())]
        for _ in range(self._parts):
            self._world.push(action_3 / self._parts)
            states.append(self._world.step(0, ()))
        self._world.run(self._settle_ms)
        self.pushes.append([*states, self._world.step(0, ())])
        return self.step_now(rng)

    def step_now(self, rng: np.random.Generator) -> Step:
        """The state now, with fresh cameras."""
        return self._world.step(0, rig(self._sim.rig, rng))

    def _tip(self, xy_m: Floats) -> Floats:
        return np.array([xy_m[0], xy_m[1], self._sim.robot.tip_height_m])


if __name__ == "__main__":
    run(main)
