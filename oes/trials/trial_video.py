"""Video of a trial: every observation with the estimated boxes, then the plan and its forecast."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oes.config import params
from oes.episode import Floats
from oes.mpc.search import Plan
from oes.trials.loop import StepRecord, TrialResult
from oes.viz.overlay import FORECAST, GOAL, PERCEIVED, PUSH, CameraOverlay
from oes.viz.video import write_gif, write_video

UNDETECTED = (150, 150, 150)  # colour of boxes without a detection


@params
class VideoConfig:
    """``zoom``: enlargement; ``*_s``: display time of an observation, a plan, the last image."""

    zoom: int
    fps: int
    observation_s: float
    plan_s: float
    end_s: float


def write_trial_video(
    result: TrialResult,
    goal_G3: Floats,
    verdict: str,
    success_m: float,
    cfg: VideoConfig,
    path: Path,
) -> None:
    """Write MP4 to ``path`` and a GIF beside it; ``verdict`` labels the last image.

    Goals are rings of radius ``success_m``.
    """
    shots: list[tuple[NDArray[np.uint8], float]] = []  # images and seconds
    for step_i, record in enumerate(result.steps):
        is_last = step_i + 1 == len(result.steps)
        observed = observed_image(record, goal_G3, success_m, cfg.zoom)
        observed.label(verdict if is_last else f"push {step_i + 1}: sees")
        shots.append((observed.pixels, cfg.end_s if is_last else cfg.observation_s))
        if record.plan is not None:
            planned = observed_image(record, goal_G3, success_m, cfg.zoom)
            _draw_plan(planned, record, record.plan, len(goal_G3))
            planned.label(f"push {step_i + 1}: plans")
            shots.append((planned.pixels, cfg.plan_s))
    frames = (pixels for pixels, seconds in shots for _ in range(round(seconds * cfg.fps)))
    write_video(frames, path, cfg.fps)
    write_gif(shots, path.with_suffix(".gif"))


def observed_image(
    record: StepRecord, goal_G3: Floats, success_m: float, zoom: int
) -> CameraOverlay:
    """Camera image with goals and estimated boxes, grey if not detected in this image."""
    image, estimate = CameraOverlay(record.rgb_HW3, record.camera, zoom), record.estimate
    for goal_3, center_3 in zip(goal_G3, estimate.center_N3, strict=False):
        on_table_3 = np.array([goal_3[0], goal_3[1], 0.0])
        image.ring(on_table_3, success_m, GOAL)
        image.line(np.stack([center_3 * [1, 1, 0], on_table_3]), GOAL)
    boxes = zip(estimate.center_N3, estimate.size_N3, estimate.is_detected_N, strict=True)
    for center_3, size_3, is_detected in boxes:
        image.box(center_3, size_3, PERCEIVED if is_detected else UNDETECTED)
    return image


def _draw_plan(image: CameraOverlay, record: StepRecord, plan: Plan, num_goals: int) -> None:
    """The planned pushes, and the predicted paths of the objects that have goals."""
    actions_T3, position_TN3 = plan.actions_T3.double().numpy(), plan.position_TN3.double().numpy()
    start_T3 = plan.tip_3.double().numpy() + np.cumsum(actions_T3, axis=0) - actions_T3
    for start_3, action_3 in zip(start_T3, actions_T3, strict=True):
        image.arrow(start_3, action_3, PUSH)
    for object_i in range(num_goals):
        start_13 = record.estimate.center_N3[None, object_i]
        path_I3 = np.concatenate([start_13, position_TN3[:, object_i]])
        image.line(path_I3, FORECAST)
        image.box(path_I3[-1], record.estimate.size_N3[object_i], FORECAST)
