"""Errors of counterfactual forecasts: of motions, images, features and detections."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
import torch
from torch import Tensor

from oes.counterfactual.compose import DecomposedScene, compose, visible_features
from oes.counterfactual.edits import Scenario
from oes.counterfactual.forecast import Counterfactual, ObjectMotion
from oes.episode import SEG_FIRST_OBJECT, SEG_ROBOT, Bools, Camera, Episode, Floats, Frames
from oes.evaluation.forecasters import to_gt_objects, true_forecast
from oes.geom.voxels import Grid, centers
from oes.metrics.errors import rotation_deg, translation_mm
from oes.perception.evaluate import match_detections, rgb_quality
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses

PHOTOGRAPH, ENCODED = "photograph", "encoded"  # sources without a motion
FutureRow = dict[str, float | int | str | None]


@dataclass(frozen=True)
class FutureEvaluator:
    """Compares composed futures of one unedited episode with the recorded ones.

    ``input_i``: the input camera. ``query_is``: the cameras to render.
    """

    perceiver: Perceiver
    source: FrameSource
    scenario: Scenario
    scene: DecomposedScene
    input_i: int
    query_is: Sequence[int]

    def renders(
        self, motions: Mapping[str, ObjectMotion], T: int, renderer: Renderer
    ) -> Iterator[FutureRow]:
        """Image and feature errors at T per motion, and of the map encoded from the image at T.

        ``objects_psnr_db`` covers pixels that show an object at T or in the first state, except
        those of the robot, whose features do not move. ``renderer``: of the episode's bodies.
        """
        frames, cameras = self._images(T)
        initial = renderer.render(mesh_poses(self.scenario.episode.steps[0]), cameras)
        segs = (frames.seg_VHW, initial.seg_VHW)
        is_object = (segs[0] >= SEG_FIRST_OBJECT) | (segs[1] >= SEG_FIRST_OBJECT)
        is_robot = (segs[0] == SEG_ROBOT) | (segs[1] == SEG_ROBOT)
        images = self.source.read(self.scenario.scene.episode_i, T, [self.input_i])
        encoded = self.perceiver.fields(self.perceiver.encode(*images))
        in_box_XYZ = _in_boxes(self.scenario.episode, T, encoded[0].grid)
        true_features = visible_features(encoded[0])[:, in_box_XYZ]
        poses = {name: motion.poses(self.scenario.poses, T) for name, motion in motions.items()}
        far_field = self.scene.far_field
        fields = {name: (compose(self.scene, pose), far_field) for name, pose in poses.items()}
        for name, (near, far) in {**fields, ENCODED: encoded}.items():
            rendered = self.perceiver.render_fields(near, far, cameras)
            error = (visible_features(near)[:, in_box_XYZ] - true_features).norm()
            yield {
                **self._keys(T, name),
                **_image_errors(rendered, frames, is_object & ~is_robot),
                "feature_error": round(float(error / true_features.norm()), 4),
            }

    def consistency(self, name: str, motion: ObjectMotion, T: int) -> Iterator[FutureRow]:
        """Detections of each composed object in one rendered view at a time.

        ``centre_mm``: mean distance from the composed centre; ``spread_mm``: between the views.
        """
        scene, poses = self.scene, motion.poses(self.scenario.poses, T)
        _, cameras = self._images(T)
        frames = self.perceiver.render_fields(compose(scene, poses), scene.far_field, cameras)
        center_N3 = (scene.center_N3[poses.source_N] + poses.translation_N3).double().numpy()
        yield from self._detection_rows(T, name, frames, cameras, center_N3)

    def detector_baseline(self, T: int) -> Iterator[FutureRow]:
        """``consistency`` of recorded images and true objects: the error of the detector alone."""
        frames, cameras = self._images(T)
        center_N3 = self.scenario.episode.steps[T].center_N3
        yield from self._detection_rows(T, PHOTOGRAPH, frames, cameras, center_N3)

    def _detection_rows(
        self, T: int, name: str, frames: Frames, cameras: Sequence[Camera], center_N3: Floats
    ) -> Iterator[FutureRow]:
        detections: list[list[Floats]] = [[] for _ in center_N3]
        for view_i, camera in enumerate(cameras):
            features = self.perceiver.encode(frames.of([view_i]), [camera])
            detected_P3 = self.perceiver.detect(features)[0].double().cpu().numpy()
            matches = match_detections(detected_P3, center_N3)
            for detected_3, object_i in zip(detected_P3, matches, strict=True):
                if object_i >= 0:
                    detections[object_i].append(detected_3)
        for object_i, (detected, center_3) in enumerate(zip(detections, center_N3, strict=True)):
            yield {
                **self._keys(T, name),
                "object_i": object_i,
                "views_found": len(detected),
                "centre_mm": _mean_distance_mm([(point, center_3) for point in detected]),
                "spread_mm": _mean_distance_mm(list(combinations(detected, 2))),
            }

    def _images(self, T: int) -> tuple[Frames, tuple[Camera, ...]]:
        return self.source.read(self.scenario.scene.episode_i, T, self.query_is)

    def _keys(self, T: int, source: str) -> FutureRow:
        task, episode_i = self.scenario.episode.task, self.scenario.scene.episode_i
        return {"task": task, "episode_i": episode_i, "T": T, "source": source}


def _mean_distance_mm(pairs: Sequence[tuple[Floats, ...]]) -> float | None:
    distances_mm = [float(np.linalg.norm(a - b)) * 1e3 for a, b in pairs]
    return round(float(np.mean(distances_mm)), 3) if distances_mm else None


def _image_errors(image: Frames, true: Frames, is_object_VHW: Bools) -> FutureRow:
    """Means over views of ``psnr_db`` and ``ssim``; ``objects_psnr_db`` over pixels of objects."""
    views = [rgb_quality(a, b) for a, b in zip(image.rgb_VHW3, true.rgb_VHW3, strict=True)]
    row: FutureRow = {
        name: round(float(np.mean([view[name] for view in views])), 4) for name in views[0]
    }
    true_P3 = true.rgb_VHW3[is_object_VHW]
    error_P3 = (image.rgb_VHW3[is_object_VHW].astype(np.float64) - true_P3) / 255
    row["objects_psnr_db"] = None
    if len(error_P3):
        row["objects_psnr_db"] = round(float(-10 * np.log10((error_P3**2).mean())), 4)
    return row


def _in_boxes(episode: Episode, T: int, grid: Grid) -> Tensor:
    """Voxels XYZ in the bounding box of an object, at T or in the first state."""
    points_XYZ3 = centers(grid)
    inside_XYZ = torch.zeros(grid.shape, dtype=torch.bool)
    for step in (episode.steps[0], episode.steps[T]):
        for center_3, size_3 in zip(step.center_N3, step.size_N3, strict=True):
            offset = (points_XYZ3 - torch.from_numpy(center_3).float()).abs()
            inside_XYZ |= (offset <= torch.from_numpy(size_3).float() / 2).all(-1)
    return inside_XYZ


def edit_rows(counterfactual: Counterfactual, horizons: Sequence[int]) -> Iterator[FutureRow]:
    """Errors per model, true object and horizon (steps); undetected objects count as static."""
    scenario, simulated = counterfactual.scenario, counterfactual.simulated
    true = true_forecast(simulated, scenario.episode.steps[0].center_N3)
    for name, motion in counterfactual.forecasts.items():
        arrays = (motion.translation_TN3.double().numpy(), motion.rotation_TN33.double().numpy())
        forecast = to_gt_objects(scenario.scene, scenario.episode, *arrays)
        error_mm_TN = translation_mm(forecast.translation_TN3, true.translation_TN3)
        error_deg_TN = rotation_deg(forecast.rotation_TN33, true.rotation_TN33)
        for object_i, T in product(range(len(forecast.detected_N)), horizons):
            yield {
                "task": simulated.task,
                "episode_i": scenario.scene.episode_i,
                "edit": counterfactual.edit,
                "model": name,
                "object_i": object_i,
                "T": T,
                "translation_mm": round(float(error_mm_TN[T - 1, object_i]), 4),
                "rotation_deg": round(float(error_deg_TN[T - 1, object_i]), 4),
                "detected": int(forecast.detected_N[object_i]),
            }
