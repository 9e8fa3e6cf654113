"""Images and videos that compare composed futures with the simulated ones."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image

from oes.counterfactual.compose import DecomposedScene, compose
from oes.counterfactual.forecast import Counterfactual
from oes.episode import Camera, Episode, Pixels
from oes.episodes.capture import scene_renderer
from oes.meshes.catalogue import Catalogue
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.render.scene import mesh_poses
from oes.sim.world import SimConfig
from oes.viz.overlay import PUSH, CameraOverlay
from oes.viz.video import sheet, write_video

ROD_LINE_M = 0.12  # drawn above the tip
VIEWS_FPS, HOLD_FRAMES = 3, 4  # states per second of videos, and repetitions of the last one

LabelledRows = list[tuple[str, list[Pixels]]]


@dataclass(frozen=True)
class FutureRenderer:
    """Renders all states of a counterfactual through a fixed camera."""

    perceiver: Perceiver
    catalogue: Catalogue
    sim: SimConfig
    scene: DecomposedScene

    def simulated(self, episode: Episode, camera: Camera) -> list[Pixels]:
        """Ray-cast images of the simulator's states."""
        renderer = scene_renderer(episode, self.catalogue, self.sim)
        return [renderer.render(mesh_poses(step), [camera]).rgb_VHW3[0] for step in episode.steps]

    def forecast(self, future: Counterfactual, model: str, camera: Camera) -> list[Pixels]:
        """Decoded images of the composed map.

        The robot's features do not move; a line shows the rod.
        """
        episode, motion = future.scenario.episode, future.forecasts[model]
        moved_I3 = np.cumsum([np.zeros(3), *episode.actions_T3], axis=0)
        images = []
        for T, tip_3 in enumerate(episode.steps[0].tip_world_3 + moved_I3):
            near = compose(self.scene, motion.poses(future.scenario.poses, T))
            frames = self.perceiver.render_fields(near, self.scene.far_field, [camera])
            image = CameraOverlay(frames.rgb_VHW3[0], camera, 1)
            if np.isfinite(tip_3).all():
                image.line(np.stack([tip_3, tip_3 + np.array([0.0, 0.0, ROD_LINE_M])]), PUSH)
            images.append(image.pixels)
        return images

    def both(self, future: Counterfactual, model: str, camera: Camera) -> LabelledRows:
        """Rows of the simulation and of one forecast."""
        label = f"{future.scenario.label}: truth"
        simulated = (label, self.simulated(future.simulated, camera))
        return [simulated, (model, self.forecast(future, model, camera))]


def zoomed(camera: Camera, factor: float) -> Camera:
    """The same camera with a longer focal length."""
    K_33 = camera.K_33.copy()
    K_33[[0, 1], [0, 1]] *= factor
    return replace(camera, K_33=K_33)


def write_gallery(
    renderer: FutureRenderer,
    futures: Sequence[Counterfactual],
    cameras: Sequence[Camera],
    models: Sequence[str],
    folder: Path,
) -> None:
    """``forecast-``, ``views-`` and ``edits-<episode>.png`` with time to the right, and a video.

    ``cameras``: the input camera, then the query cameras. The first of ``futures`` is unedited.
    """
    unedited, name = futures[0], f"{futures[0].scenario.scene.episode_i:06d}"
    input_camera, *queries = cameras
    rows = [("truth", renderer.simulated(unedited.simulated, input_camera))]
    rows += [(model, renderer.forecast(unedited, model, input_camera)) for model in models]
    _save(folder / f"forecast-{name}.png", rows)
    views = [renderer.both(unedited, models[0], camera) for camera in queries]
    _save(folder / f"views-{name}.png", [row for view in views for row in view])
    frames = [
        np.hstack([np.vstack([images[T] for _, images in view]) for view in views])
        for T in range(len(unedited.simulated.steps))
    ]
    write_video([*frames, *frames[-1:] * HOLD_FRAMES], folder / f"views-{name}.mp4", VIEWS_FPS)
    edits = [row for future in futures for row in renderer.both(future, models[0], input_camera)]
    _save(folder / f"edits-{name}.png", edits)


def write_predictions(
    perceiver: Perceiver,
    source: FrameSource,
    episode_i: int,
    camera_is: tuple[Sequence[int], Sequence[int]],
    path: Path,
) -> None:
    """Predicted views of the first state from one and from three input views, below the true ones.

    ``camera_is``: at least three input cameras, and the query cameras.
    """
    inputs, queries = camera_is
    frames, cameras = source.read(episode_i, 0, queries)
    rows: LabelledRows = [("photographs", list(frames.rgb_VHW3))]
    for count, label in ((1, "from one view"), (3, "from three views")):
        features = perceiver.encode(*source.read(episode_i, 0, inputs[:count]))
        predicted = perceiver.render_fields(*perceiver.fields(features), cameras)
        rows.append((label, list(predicted.rgb_VHW3)))
    _save(path, rows)


def _save(path: Path, rows: LabelledRows) -> None:
    Image.fromarray(sheet(rows)).save(path)
