"""Imagined futures held against what came: as pictures, as features, and seen again from several
sides (A.1).
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.counterfactual.compose import DecomposedScene, compose, visible
from oes.counterfactual.edits import Scenario
from oes.counterfactual.forecast import ObjectMotion
from oes.episode import SEG_FIRST_OBJECT, SEG_ROBOT, Camera, Episode, Floats, Frames
from oes.episodes.capture import scene_renderer
from oes.geom.voxels import Grid, centers
from oes.meshes.catalogue import Catalogue
from oes.perception.evaluate import match_detections, picture_quality
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.render.scene import mesh_poses
from oes.sim.world import SimConfig

PHOTOGRAPH, ENCODED = "photograph", "encoded"
FutureRow = dict[str, float | int | str | None]
Bools = NDArray[np.bool_]
RENDER_COLUMNS = (
    "task",
    "episode_i",
    "T",
    "source",
    "psnr_db",
    "ssim",
    "objects_psnr_db",
    "feature_error",
)
CONSISTENCY_COLUMNS = (
    "task",
    "episode_i",
    "T",
    "source",
    "object_i",
    "views_found",
    "centre_mm",
    "spread_mm",
)


class FutureEvaluator:
    """Looks at one episode's future states, as they were and as they are imagined, through some of
    its cameras.
    """

    def __init__(
        self,
        perceiver: Perceiver,
        source: FrameSource,
        case: Scenario,
        camera_is: tuple[int, Sequence[int]],
    ) -> None:
        """``camera_is``: the camera of the first photograph, and those to look through."""
        self.perceiver, self.source, self.case = perceiver, source, case
        self.episode, self.episode_i = case.episode, case.scene.episode_i
        self.input_i, self.query_is = camera_is

    def renders(
        self,
        still: DecomposedScene,
        imagined: Mapping[str, ObjectMotion],
        T: int,
        catalogue: Catalogue,
        sim: SimConfig,
    ) -> Iterator[FutureRow]:
        """A row per motion at T, and one for the map encoded from the true photograph at T
        (``encoded``).
        """
        frames, cameras = self.source.read(self.episode_i, T, self.query_is)
        shown_VHW = self._objects_shown(T, frames, cameras, catalogue, sim)
        fields = self.perceiver.fields(
            self.perceiver.encode(*self.source.read(self.episode_i, T, [self.input_i]))
        )
        near_XYZ = _inside_hulls(self.episode, T, fields[0].grid)
        true_features = visible(fields[0])[:, near_XYZ]
        views = {
            word: (compose(still, motion.poses(self.case.poses, T)), still.backdrop)
            for word, motion in imagined.items()
        }
        for word, (near, backdrop) in {**views, ENCODED: fields}.items():
            made = self.perceiver.look(near, backdrop, cameras)
            error = (visible(near)[:, near_XYZ] - true_features).norm() / true_features.norm()
            yield {
                **self._about(T, word),
                **_qualities(made, frames, shown_VHW),
                "feature_error": round(float(error), 4),
            }

    def consistency(
        self, still: DecomposedScene, word: str, motion: ObjectMotion, T: int
    ) -> Iterator[FutureRow]:
        """A row per drawn object: where one rendered view at a time says that it is."""
        poses = motion.poses(self.case.poses, T)
        _, cameras = self.source.read(self.episode_i, T, self.query_is)
        made = self.perceiver.look(compose(still, poses), still.backdrop, cameras)
        drawn_N3 = (still.center_N3[poses.which_M] + poses.translation_M3).double().numpy()
        yield from self._found_again(T, word, made, cameras, drawn_N3)

    def photographs(self, T: int) -> Iterator[FutureRow]:
        """The same of true photographs and objects: what detection alone leaves of consistency."""
        frames, cameras = self.source.read(self.episode_i, T, self.query_is)
        yield from self._found_again(
            T, PHOTOGRAPH, frames, cameras, self.episode.steps[T].center_N3
        )

    def _found_again(
        self, T: int, word: str, frames: Frames, cameras: Sequence[Camera], true_N3: Floats
    ) -> Iterator[FutureRow]:
        places: list[list[Floats]] = [[] for _ in true_N3]
        for view_i, camera in enumerate(cameras):
            scene = self.perceiver.encode(frames.of([view_i]), [camera])
            found_M3 = self.perceiver.detect(scene)[0].double().cpu().numpy()
            for place_3, true_i in zip(found_M3, match_detections(found_M3, true_N3), strict=True):
                if true_i >= 0:
                    places[true_i].append(place_3)
        for object_i, (place_V3, true_3) in enumerate(zip(places, true_N3, strict=True)):
            away = [float(np.linalg.norm(place_3 - true_3)) * 1e3 for place_3 in place_V3]
            apart = [float(np.linalg.norm(a - b)) * 1e3 for a, b in combinations(place_V3, 2)]
            yield {
                **self._about(T, word),
                "object_i": object_i,
                "views_found": len(place_V3),
                "centre_mm": round(float(np.mean(away)), 3) if away else None,
                "spread_mm": round(float(np.mean(apart)), 3) if apart else None,
            }

    def _about(self, T: int, word: str) -> FutureRow:
        return {"task": self.episode.task, "episode_i": self.episode_i, "T": T, "source": word}

    def _objects_shown(
        self,
        T: int,
        frames: Frames,
        cameras: Sequence[Camera],
        catalogue: Catalogue,
        sim: SimConfig,
    ) -> Bools:
        """Pixels VHW that show an object now, or would at first, and at neither time the robot,
        which is not moved.
        """
        renderer = scene_renderer(self.episode, catalogue, sim)
        first = renderer.render(mesh_poses(self.episode.steps[0]), cameras).seg_VHW
        is_object, is_robot = (
            (a | b) for a, b in zip(_kinds(frames.seg_VHW), _kinds(first), strict=True)
        )
        return np.asarray(is_object & ~is_robot)


def _kinds(seg_VHW: NDArray[np.uint8]) -> tuple[Bools, Bools]:
    return seg_VHW >= SEG_FIRST_OBJECT, seg_VHW == SEG_ROBOT


def _qualities(made: Frames, true: Frames, shown_VHW: Bools) -> FutureRow:
    """Means over views of ``psnr_db`` and ``ssim``; ``objects_psnr_db`` over pixels that show
    objects, if any do.
    """
    each = [picture_quality(a, b) for a, b in zip(made.rgb_VHW3, true.rgb_VHW3, strict=True)]
    row: FutureRow = {
        name: round(float(np.mean([one[name] for one in each])), 4) for name in each[0]
    }
    error_P3 = (made.rgb_VHW3[shown_VHW].astype(np.float64) - true.rgb_VHW3[shown_VHW]) / 255
    row["objects_psnr_db"] = (
        round(float(-10 * np.log10((error_P3**2).mean())), 4) if len(error_P3) else None
    )
    return row


def _inside_hulls(episode: Episode, T: int, grid: Grid) -> Tensor:
    """Voxels XYZ in the hull of an object now or at first."""
    points_XYZ3 = centers(grid)
    inside = torch.zeros(grid.shape, dtype=torch.bool)
    for step in (episode.steps[0], episode.steps[T]):
        for center_3, size_3 in zip(step.center_N3, step.size_N3, strict=True):
            away = (points_XYZ3 - torch.from_numpy(center_3).float()).abs()
            inside |= (away <= torch.from_numpy(size_3).float() / 2).all(-1)
    return inside
