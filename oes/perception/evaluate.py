"""Errors of perception against the ground truth: rows of detections and of predicted views."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.episode import Episode, Floats, Ints
from oes.geom.assignment import assign
from oes.geom.boxes import iou
from oes.geom.voxels import Grid, voxelize
from oes.metrics.errors import Boxes, average_precision, chamfer_mm, normal_deg
from oes.metrics.image_metrics import image_quality
from oes.perception.gt_profiles import profile_to_point_cloud
from oes.perception.network import SceneFeatures
from oes.perception.perceiver import Perceiver
from oes.perception.solids import Solids
from oes.perception.surface import support_points
from oes.schema import BOX

DETECTION_MATCH_M = 0.06
SHAPE_METRICS = ("mask_iou", "chamfer_mm", "normal_deg")
PerceptionRow = dict[str, float | None]


@dataclass(frozen=True)
class GroundTruthObjects:
    """Objects of one state in world coordinates.

    ``solids``: points that fill each object. ``surfaces``: surface points and their normals.
    """

    center_N3: Floats
    size_N3: Floats
    solids: list[Floats]
    surfaces: list[tuple[Floats, Floats]]


def gt_objects(episode: Episode, step_i: int, solids: Solids) -> GroundTruthObjects:
    """Ground truth of a recorded state. Raises KeyError for a mesh not in the catalogue."""
    step = episode.steps[step_i]
    return GroundTruthObjects(
        step.center_N3,
        step.size_N3,
        list(map(solids.posed, episode.bodies, step.world_T_obj_N44)),
        list(map(solids.surface, episode.bodies, step.world_T_obj_N44)),
    )


def match_detections(predicted_N3: Floats, true_N3: Floats) -> Ints:
    """Index of the true centre within ``DETECTION_MATCH_M`` assigned to each prediction, or -1."""
    return assign(predicted_N3, true_N3, DETECTION_MATCH_M)


def mask_ious(
    mask_NXYZ: Tensor, center_N3: Tensor, window: Grid, solids: Sequence[Floats]
) -> Floats:
    """IoU N of predicted masks (probabilities, in a window around each centre) with solids."""
    pairs = zip(solids, center_N3, strict=True)
    points = [torch.from_numpy(solid).float() - center_3 for solid, center_3 in pairs]
    true_NXYZ = voxelize(torch.stack(points), window) if points else mask_NXYZ > 1
    predicted_NXYZ = mask_NXYZ > 0.5
    shared_N = (predicted_NXYZ & true_NXYZ).flatten(1).sum(1)
    union_N = (predicted_NXYZ | true_NXYZ).flatten(1).sum(1)
    return (shared_N / union_N.clamp(min=1)).double().numpy()


def detection_rows(
    perceiver: Perceiver, scene: SceneFeatures, truth: GroundTruthObjects
) -> list[PerceptionRow]:
    """One row for every detection (matched or false) and for every missed object of one scene."""
    centers, sizes, scores = (value.float().cpu() for value in perceiver.detect(scene))
    gt_N = match_detections(centers.double().numpy(), truth.center_N3)
    matched = np.flatnonzero(gt_N >= 0).tolist()
    boxes = centers[matched], sizes[matched]
    mask_NXYZ = perceiver.crops(scene, boxes)[:, 0].float().cpu()
    solids = [truth.solids[i] for i in gt_N[matched]]
    surfaces = [truth.surfaces[i] for i in gt_N[matched]]
    ious = mask_ious(mask_NXYZ, boxes[0], perceiver.net.roi.window, solids)
    errors = _surface_errors(perceiver, scene, boxes, mask_NXYZ, surfaces)
    quality = {i: (ious[k], *errors[k]) for k, i in enumerate(matched)}
    box_N6 = torch.cat([centers, sizes], dim=1).double().numpy()
    true_N6 = np.concatenate([truth.center_N3, truth.size_N3], axis=1)
    rows = []
    for i, true_i in enumerate(gt_N):
        row = _boxes_row(box_N6[i], true_N6[true_i] if i in quality else None)
        row["score"] = float(scores[i])
        if i in quality:
            row |= dict(zip(SHAPE_METRICS, map(float, quality[i]), strict=True))
            center, true_center = box_N6[i, :3], true_N6[true_i, :3]
            row["iou"] = float(iou(center, box_N6[i, 3:], true_center, true_N6[true_i, 3:]))
            row["centre_mm"] = float(np.linalg.norm(center - true_center) * 1e3)
        rows.append(row)
    missed = [i for i in range(len(true_N6)) if i not in gt_N]
    return rows + [_boxes_row(None, true_N6[i]) for i in missed]


def _surface_errors(
    perceiver: Perceiver,
    scene: SceneFeatures,
    boxes: tuple[Tensor, Tensor],
    mask_NXYZ: Tensor,
    surfaces: Sequence[tuple[Floats, Floats]],
) -> list[tuple[float, float]]:
    """Chamfer distance (mm) and error of the normals (degrees) of completed surfaces."""
    profile_NRD3 = perceiver.surfaces(scene, boxes, mask_NXYZ)[0].float().cpu()
    support_N3 = support_points(*boxes)
    top_N = boxes[0][:, 2] + boxes[1][:, 2] / 2 - support_N3[:, 2]
    cylinder, errors = perceiver.net.cfg.surface.cylinder, []
    for i, true in enumerate(surfaces):
        cloud = profile_to_point_cloud(profile_NRD3[i], cylinder, float(top_N[i]))
        points, normals = (cloud[0] + support_N3[i]).double().numpy(), cloud[1].double().numpy()
        errors.append((chamfer_mm(points, true[0]), normal_deg(points, normals, *true)))
    return errors


def detection_summary(rows: Sequence[PerceptionRow]) -> dict[str, float]:
    """Average precision (``ap_25``, ``ap_50``) and mean errors of matched detections.

    Without a match ``mask_iou`` is 0; ``centre_mm``, ``chamfer_mm`` and ``normal_deg`` are NaN.
    ``rows``: those of ``detection_rows`` with the column ``episode``.
    """
    detected = [row for row in rows if row["x_m"] is not None]
    true = [row for row in rows if row["true_x_m"] is not None]
    matched = [row for row in detected if row["true_x_m"] is not None]
    boxes = _boxes(detected, ""), _column(detected, "score"), _boxes(true, "true_")
    empty = {"mask_iou": 0.0} | dict.fromkeys(("centre_mm", "chamfer_mm", "normal_deg"), np.nan)
    return {f"ap_{percent}": average_precision(*boxes, percent / 100) for percent in (25, 50)} | {
        name: float(np.mean(_column(matched, name))) if matched else value
        for name, value in empty.items()
    }


def rgb_quality(predicted_HW3: NDArray[np.uint8], true_HW3: NDArray[np.uint8]) -> dict[str, float]:
    """``psnr_db`` and ``ssim`` of a predicted image."""
    images = (torch.from_numpy(np.array(image)) for image in (predicted_HW3, true_HW3))
    return image_quality(*(image.movedim(-1, 0).float() / 255 for image in images))


def _boxes_row(box_6: Floats | None, true_6: Floats | None) -> PerceptionRow:
    row: PerceptionRow = dict.fromkeys(("score", "iou", "centre_mm", *SHAPE_METRICS))
    for prefix, values in (("", box_6), ("true_", true_6)):
        for i, name in enumerate(BOX):
            row[prefix + name] = None if values is None else float(values[i])
    return row


def _boxes(rows: Sequence[PerceptionRow], prefix: str) -> Boxes:
    values = np.stack([_column(rows, prefix + name) for name in BOX], axis=1)
    return Boxes(_column(rows, "episode").astype(np.int64), values[:, :3], values[:, 3:])


def _column(rows: Sequence[PerceptionRow], name: str) -> Floats:
    return np.array([np.nan if row[name] is None else row[name] for row in rows], dtype=np.float64)
