"""One push planned and executed on a novel object: forecast and execution side by side in demo.mp4.

``python -m oes.apps.demo`` needs no dataset: it uses the weights in git and makes a small catalogue
of meshes if there is none.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from oes.apps.assets import DATASETS, KEPT, find_catalogue, find_weights
from oes.cli import run
from oes.config import PARAMS, load, params
from oes.episode import Floats, Pixels, Step
from oes.meshes.catalogue import Catalogue
from oes.perception.perceiver import Perceiver
from oes.sim.pushing import PushWorld
from oes.sim.world import SimConfig
from oes.trials import runner
from oes.trials.loop import StepRecord, run_trial
from oes.trials.task import Task, draw_task, generator
from oes.trials.trial_video import observed_image
from oes.trials.world_models import load_world_model
from oes.viz.overlay import FORECAST, GOAL, PUSH, CameraOverlay
from oes.viz.video import write_video

log = logging.getLogger(__name__)

SCENARIO, PLANNER, MODEL = "targets", "cem", "oes"
DEMO_FILE = Path("demo.mp4")
ROD_LENGTH_M = 0.15


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
    trials = load(PARAMS, "trials", runner.TrialsConfig)
    scenario = replace(trials.scenarios[SCENARIO], num_objects=(1, 1), goal_distance_m=cfg.goal_m)
    perception, dynamics = find_weights((KEPT, DATASETS), (MODEL,))
    catalogue, model = find_catalogue(), load_world_model(dynamics[MODEL])
    planner = runner.make_planner(trials, Perceiver.load(perception), model)
    streams = (runner.TASK_STREAM, runner.CAMERA_STREAM, runner.PLAN_STREAM)
    task_rng, *rngs = (generator(cfg.seed, "demo", 0, stream) for stream in streams)
    task = draw_task(catalogue, trials.sim, scenario, task_rng)
    sensor = runner.CameraSensor(catalogue, trials.sim, task.bodies)
    with SteppedPushWorld(catalogue, trials.sim, scenario.settle_ms, cfg.frames_per_push) as world:
        search = scenario.planners[PLANNER]
        result = run_trial(world, sensor, planner, task, scenario, search, (rngs[0], rngs[1]))
        video = DemoVideo(cfg, sensor, task, scenario.success_m)
        write_video(video.frames(result.steps, world.pushes), DEMO_FILE, cfg.fps)
    start_mm, end_mm = result.initial_G.mean() * 1e3, result.final_G.mean() * 1e3
    distances = f"{start_mm:.0f} mm from the goal at the start, {end_mm:.0f} mm"
    log.info("%s: %s after %d pushes", DEMO_FILE, distances, result.steps_used)


class SteppedPushWorld(PushWorld):
    """A PushWorld that records the states during every push: ``pushes[i]``, from start to rest."""

    def __init__(
        self, catalogue: Catalogue, sim: SimConfig, settle_ms: int, states_per_push: int
    ) -> None:
        """Raises ValueError unless a timestep divides into states of whole physics steps."""
        timestep_ms = sim.physics.timestep_ms // states_per_push
        physics = replace(sim.physics, timestep_ms=timestep_ms)
        super().__init__(catalogue, replace(sim, physics=physics), settle_ms)
        self.num_parts = states_per_push
        self.pushes: list[list[Step]] = []

    def push(self, tip_start_xy_m: Floats, action_3: Floats, rng: np.random.Generator) -> Step:
        """One push in equal parts at the same speed, then rest."""
        self._world.arm.reset_to(self._tip(tip_start_xy_m))
        states = [self._world.step(0, ())]
        for _ in range(self.num_parts):
            self._world.push(action_3 / self.num_parts)
            states.append(self._world.step(0, ()))
        self._world.run(self._settle_ms)
        self.pushes.append([*states, self._world.step(0, ())])
        return self.step_now(rng)


@dataclass(frozen=True)
class DemoVideo:
    """Frames of a trial: the planner's observation and forecast left, the execution right."""

    cfg: DemoConfig
    sensor: runner.CameraSensor
    task: Task
    success_m: float

    def frames(self, records: tuple[StepRecord, ...], pushes: list[list[Step]]) -> Iterator[Pixels]:
        """All frames, from the camera that the planner used at each step."""
        hold, remaining = round(self.cfg.hold_s * self.cfg.fps), iter(pushes)
        for record in records:
            yield from [self._frame(record, 0.0, record.rgb_HW3)] * hold
            if record.plan is None:
                continue
            for state_i, state in enumerate(next(remaining)):
                share = min(1.0, state_i / self.cfg.frames_per_push)
                rgb_HW3 = self.sensor(state, record.camera).frames.rgb_VHW3[0]
                yield self._frame(record, share, rgb_HW3)
            yield from [self._frame(record, 1.0, rgb_HW3)] * hold

    def _frame(self, record: StepRecord, share: float, rgb_HW3: Pixels) -> Pixels:
        """The forecast after ``share`` of the push beside the executed state."""
        left = observed_image(record, self.task.goal_G3, self.success_m, self.cfg.zoom)
        left.label("forecast" if record.plan else "observed")
        _draw_forecast(left, record, share)
        right = CameraOverlay(rgb_HW3, record.camera, self.cfg.zoom)
        for goal in self.task.goal_G3:
            right.ring(goal * [1, 1, 0], self.success_m, GOAL)
        right.label("executed")
        return np.concatenate([left.pixels, right.pixels], axis=1)


def _draw_forecast(overlay: CameraOverlay, record: StepRecord, share: float) -> None:
    """Draw the rod and the boxes after ``share`` of the push, interpolated linearly."""
    if record.plan is None:
        return
    tip_3, action_3 = record.plan.tip_3.double().numpy(), record.plan.actions_T3[0].double().numpy()
    overlay.arrow(tip_3, action_3, PUSH)
    rod_3 = tip_3 + share * action_3
    overlay.line(np.stack([rod_3, rod_3 + np.array([0, 0, ROD_LENGTH_M])]), PUSH)
    end_N3 = record.plan.position_TN3[0].double().numpy()
    estimate = record.estimate
    for start, end, size in zip(estimate.center_N3, end_N3, estimate.size_N3, strict=True):
        overlay.box(start + share * (end - start), size, FORECAST)


if __name__ == "__main__":
    run(main)
