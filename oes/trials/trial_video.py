"""A trial as a film: each photograph the planner got, what it believed, and the push it chose with
its forecast.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oes.config import params
from oes.episode import Floats
from oes.trials.loop import StepRecord, TrialResult
from oes.viz.overlay import GOAL, IMAGINED, PUSH, SEEN, CameraOverlay, write_gif, write_video

LOST = (150, 150, 150)


@params
class VideoConfig:
    """Enlargement of the photographs, pictures a second, and how long each stage of a step stays on
    screen.
    """

    zoom: int
    pictures_per_s: int
    look_s: float
    push_s: float
    end_s: float


def write_trial_video(
    outcome: TrialResult,
    goal_G3: Floats,
    verdict: str,
    success_m: float,
    cfg: VideoConfig,
    path: Path,
) -> None:
    """One trial as ``path`` (MP4) and as a GIF beside it.

    Goals are rings of radius ``success_m``, ``verdict`` stands over the end.
    """
    shots = list(trial_shots(outcome, goal_G3, verdict, success_m, cfg))
    held = (pixels for pixels, seconds in shots for _ in range(round(seconds * cfg.pictures_per_s)))
    write_video(held, path, cfg.pictures_per_s)
    write_gif(shots, path.with_suffix(".gif"))


def trial_shots(
    outcome: TrialResult, goal_G3: Floats, verdict: str, success_m: float, cfg: VideoConfig
) -> Iterator[tuple[NDArray[np.uint8], float]]:
    """Pictures and how long each is shown (s): what is seen and what is planned at every step, then
    the end.
    """
    for step_i, moment in enumerate(outcome.moments):
        is_last = step_i + 1 == len(outcome.moments)
        seen = observed_image(moment, goal_G3, success_m, cfg.zoom)
        seen.label(verdict if is_last else f"push {step_i + 1}: sees")
        yield seen.pixels, cfg.end_s if is_last else cfg.look_s
        if moment.chosen is not None:
            planned = planned_image(moment, goal_G3, success_m, cfg.zoom)
            planned.label(f"push {step_i + 1}: plans")
            yield planned.pixels, cfg.push_s


def planned_image(
    moment: StepRecord, goal_G3: Floats, success_m: float, zoom: int
) -> CameraOverlay:
    """What was perceived, the pushes planned and where the forecast puts the objects that have
    goals.
    """
    picture = observed_image(moment, goal_G3, success_m, zoom)
    if moment.chosen is not None:
        tip, actions = (
            moment.chosen.tip_3.double().numpy(),
            moment.chosen.actions_T3.double().numpy(),
        )
        for start, action in zip(tip + np.cumsum(actions, axis=0) - actions, actions, strict=True):
            picture.arrow(start, action, PUSH)
        positions_HN3 = moment.chosen.position_TN3.double().numpy()
        for object_i in range(len(goal_G3)):
            path = np.concatenate(
                [moment.belief.center_N3[None, object_i], positions_HN3[:, object_i]]
            )
            picture.line(path, IMAGINED)
            picture.box(path[-1], moment.belief.size_N3[object_i], IMAGINED)
    return picture


def observed_image(
    moment: StepRecord, goal_G3: Floats, success_m: float, zoom: int
) -> CameraOverlay:
    """The photograph with goals and perceived boxes; grey boxes are of objects not seen this
    time.
    """
    picture = CameraOverlay(moment.rgb_HW3, moment.camera, zoom)
    belief = moment.belief
    for goal, center in zip(goal_G3, belief.center_N3, strict=False):
        on_table = np.array([goal[0], goal[1], 0.0])
        picture.ring(on_table, success_m, GOAL)
        picture.line(np.stack([center * [1, 1, 0], on_table]), GOAL)
    for center, size, is_seen in zip(
        belief.center_N3, belief.size_N3, belief.is_seen_N, strict=True
    ):
        picture.box(center, size, SEEN if is_seen else LOST)
    return picture
