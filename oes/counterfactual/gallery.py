"""Pictures of imagined futures beside the true ones: forecasts, the same from three sides, and
changed scenes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from oes.counterfactual.compose import DecomposedScene, PoseTable, compose
from oes.counterfactual.counterfactuals import Counterfactual
from oes.episode import Camera, Episode, Floats
from oes.episodes.capture import scene_renderer
from oes.meshes.catalogue import Catalogue
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.render.scene import mesh_poses
from oes.sim.world import SimConfig
from oes.viz.overlay import PUSH, CameraOverlay, Pixels
from oes.viz.video import sheet, write_video

ROD_M = 0.12  # how much of the rod is drawn
PICTURES_PER_S, HOLD = 3, 4  # states a second in films, and how many pictures the last one stays


@dataclass(frozen=True)
class FutureRenderer:
    """Shows all states of an episode through cameras that stand still, as they were or as they are
    imagined.
    """

    perceiver: Perceiver
    catalogue: Catalogue
    sim: SimConfig
    still: DecomposedScene

    def true(self, happened: Episode, camera: Camera) -> list[Pixels]:
        """Rendered from the simulator's states."""
        renderer = scene_renderer(happened, self.catalogue, self.sim)
        return [renderer.render(mesh_poses(step), [camera]).rgb_VHW3[0] for step in happened.steps]

    def imagined(self, answer: Counterfactual, model: str, camera: Camera) -> list[Pixels]:
        """Decoded from synthesised maps; the robot's features stay, a line shows where its rod
        is.
        """
        episode, motion = answer.case.episode, answer.found[model]
        tip_T3 = episode.steps[0].tip_world_3 + np.cumsum(
            [np.zeros(3), *episode.actions_T3], axis=0
        )
        return [
            self._one(motion.poses(answer.case.poses, T), camera, tip_3)
            for T, tip_3 in enumerate(tip_T3)
        ]

    def _one(self, poses: PoseTable, camera: Camera, tip_3: Floats) -> Pixels:
        near = compose(self.still, poses)
        picture = CameraOverlay(
            self.perceiver.look(near, self.still.backdrop, [camera]).rgb_VHW3[0], camera, 1
        )
        if np.isfinite(tip_3).all():
            picture.line(np.stack([tip_3, tip_3 + np.array([0.0, 0.0, ROD_M])]), PUSH)
        return picture.pixels


def zoomed(camera: Camera, factor: float) -> Camera:
    """The same camera with a longer lens."""
    K_33 = camera.K_33.copy()
    K_33[[0, 1], [0, 1]] *= factor
    return replace(camera, K_33=K_33)


def write_pictures(
    painter: FutureRenderer,
    answers: Sequence[Counterfactual],
    cameras: Sequence[Camera],
    models: Sequence[str],
    folder: Path,
) -> None:
    """``forecast-``, ``views-`` and ``edits-<episode>.png`` with time to the right, and
    ``views-<episode>.mp4``.

    ``cameras``: that of the first photograph, then those to look through; the first answer is of
    the unchanged scene.
    """
    plain, name = answers[0], f"{answers[0].case.scene.episode_i:06d}"
    _save(folder / f"forecast-{name}.png", _forecasts(painter, plain, cameras[0], models))
    sides = {camera.name: _pair(painter, plain, camera, models[0]) for camera in cameras[1:]}
    _save(folder / f"views-{name}.png", [row for rows in sides.values() for row in rows])
    films = [
        np.hstack([np.vstack([tiles[T] for _, tiles in rows]) for rows in sides.values()])
        for T in _times(plain)
    ]
    write_video([*films, *films[-1:] * HOLD], folder / f"views-{name}.mp4", PICTURES_PER_S)
    edits = [row for answer in answers for row in _pair(painter, answer, cameras[0], models[0])]
    _save(folder / f"edits-{name}.png", edits)


def write_predictions(
    perceiver: Perceiver,
    source: FrameSource,
    episode_i: int,
    camera_is: tuple[Sequence[int], Sequence[int]],
    path: Path,
) -> None:
    """Views that were not seen, predicted from one and from three that were (first frame), below
    photographs of them.

    ``camera_is``: those to see with, at least three, and those to predict.
    """
    frames, cameras = source.read(episode_i, 0, camera_is[1])
    rows: RowsByTable = [("photographs", list(frames.rgb_VHW3))]
    for count, words in ((1, "from one view"), (3, "from three views")):
        fields = perceiver.fields(
            perceiver.encode(*source.read(episode_i, 0, camera_is[0][:count]))
        )
        rows.append((words, list(perceiver.look(*fields, cameras).rgb_VHW3)))
    _save(path, rows)


RowsByTable = list[tuple[str, list[Pixels]]]


def _forecasts(
    painter: FutureRenderer, answer: Counterfactual, camera: Camera, models: Sequence[str]
) -> RowsByTable:
    rows = [("truth", painter.true(answer.happened, camera))]
    return rows + [(model, painter.imagined(answer, model, camera)) for model in models]


def _pair(
    painter: FutureRenderer, answer: Counterfactual, camera: Camera, model: str
) -> RowsByTable:
    """The truth and one model's forecast."""
    truth, imagined = painter.true(answer.happened, camera), painter.imagined(answer, model, camera)
    return [(f"{answer.case.words}: truth", truth), (model, imagined)]


def _times(answer: Counterfactual) -> range:
    return range(len(answer.happened.steps))


def _save(path: Path, rows: RowsByTable) -> None:
    Image.fromarray(sheet(rows)).save(path)
