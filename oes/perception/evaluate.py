"""How well a perceiver sees: rows of its detections and of its predicted views against the truth,
and their summary.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.episode import Camera, Episode, Floats, Frames, Ints
from oes.geom.assignment import assign
from oes.geom.boxes import iou, support_height
from oes.geom.voxels import Grid, voxelize
from oes.metrics.errors import Boxes, average_precision, chamfer_mm, normal_deg
from oes.metrics.image_metrics import image_quality
from oes.perception.gt_profiles import profile_to_point_cloud
from oes.perception.network import SceneFeatures
from oes.perception.perceiver import Perceiver
from oes.perception.solids import Solids
from oes.schema import BOX

DETECTION_MATCH_M = 0.06
PerceptionRow = dict[str, float | None]


@dataclass(frozen=True)
class TrueObjects:
    """The true objects of one state: boxes (world axes), points that fill each, and points of the
    surface of each with their normals (both world).
    """

    center_N3: Floats
    size_N3: Floats
    solids: tuple[Floats, ...]
    surfaces: tuple[tuple[Floats, Floats], ...]


def true_objects(episode: Episode, step_i: int, solids: Solids) -> TrueObjects:
    """The truth of one recorded state. Raises KeyError where the catalogue lacks a mesh."""
    step = episode.steps[step_i]
    posed = [
        solids.posed(body, pose)
        for body, pose in zip(episode.bodies, step.world_T_obj_N44, strict=True)
    ]
    surfaces = [
        solids.surface(body, pose)
        for body, pose in zip(episode.bodies, step.world_T_obj_N44, strict=True)
    ]
    return TrueObjects(step.center_N3, step.size_N3, tuple(posed), tuple(surfaces))


def match_detections(predicted_N3: Floats, true_N3: Floats) -> Ints:
    """Index of the true centre within ``DETECTION_MATCH_M`` assigned to each prediction, or -1."""
    return assign(predicted_N3, true_N3, DETECTION_MATCH_M)


def mask_ious(
    mask_NXYZ: Tensor, centers_N3: Tensor, window: Grid, solids: Sequence[Floats]
) -> Floats:
    """IoU of each predicted mask (probabilities, in a window centred at the box) with the solid it
    stands for.
    """
    points = [
        torch.from_numpy(solid).float() - center
        for solid, center in zip(solids, centers_N3, strict=True)
    ]
    true = voxelize(torch.stack(points), window) if points else mask_NXYZ > 1
    guess = mask_NXYZ > 0.5
    shared = (guess & true).flatten(1).sum(1)
    return (shared / (guess | true).flatten(1).sum(1).clamp(min=1)).double().numpy()


def detection_rows(
    perceiver: Perceiver, scene: SceneFeatures, truth: TrueObjects
) -> list[PerceptionRow]:
    """One row for every detection (matched or false) and for every missed object of one scene."""
    centers, sizes, scores = (value.float().cpu() for value in perceiver.detect(scene))
    gt_N = match_detections(centers.double().numpy(), truth.center_N3)
    hits = [i for i, true_i in enumerate(gt_N) if true_i >= 0]
    mask = perceiver.crops(scene, centers[None, hits], sizes[None, hits])[0, :, 0].float().cpu()
    masks = mask_ious(
        mask, centers[hits], perceiver.net.roi.window, [truth.solids[gt_N[i]] for i in hits]
    )
    shapes = _surface_errors(
        perceiver,
        scene,
        (centers[hits], sizes[hits]),
        mask,
        [truth.surfaces[gt_N[i]] for i in hits],
    )
    quality = {i: (masks[k], *shapes[k]) for k, i in enumerate(hits)}
    boxes = torch.cat([centers, sizes], dim=1).double().numpy()
    true_boxes = np.concatenate([truth.center_N3, truth.size_N3], axis=1)
    rows = [
        _detection(
            boxes[i], float(scores[i]), true_boxes[true_i] if true_i >= 0 else None, quality.get(i)
        )
        for i, true_i in enumerate(gt_N)
    ]
    missed = [true_i for true_i in range(len(true_boxes)) if true_i not in gt_N]
    return rows + [_boxes_row(None, true_boxes[true_i]) for true_i in missed]


def _surface_errors(
    perceiver: Perceiver,
    scene: SceneFeatures,
    boxes: tuple[Tensor, Tensor],
    mask_NXYZ: Tensor,
    surfaces: Sequence[tuple[Floats, Floats]],
) -> list[tuple[float, float]]:
    """Chamfer distance (mm) and error of the normals (degrees) of the completed surface of each
    matched detection.
    """
    radial_profile_NRD3 = perceiver.surfaces(scene, *boxes, mask_NXYZ)[0].float().cpu()
    foot_N3 = torch.cat([boxes[0][:, :2], support_height(*boxes)[:, None]], -1)
    top_N = boxes[0][:, 2] + boxes[1][:, 2] / 2 - foot_N3[:, 2]
    errors = []
    for outline, foot_3, top, (true_P3, true_normal_P3) in zip(
        radial_profile_NRD3, foot_N3, top_N, surfaces, strict=True
    ):
        points_P3, normal_P3 = profile_to_point_cloud(
            outline, perceiver.net.cfg.surface.cylinder, float(top)
        )
        found_P3, found_normal_P3 = (
            (points_P3 + foot_3).double().numpy(),
            normal_P3.double().numpy(),
        )
        angle = normal_deg(found_P3, found_normal_P3, true_P3, true_normal_P3)
        errors.append((chamfer_mm(found_P3, true_P3), angle))
    return errors


def detection_summary(rows: Sequence[PerceptionRow]) -> dict[str, float]:
    """``ap_25``, ``ap_50``; means over matched detections of ``mask_iou``, ``centre_mm``,
    ``chamfer_mm`` and ``normal_deg`` (without any: 0, and NaN).

    ``rows`` are those of ``detection_rows`` with a column ``episode`` that tells scenes apart.
    """
    found = [row for row in rows if row["x_m"] is not None]
    true = [row for row in rows if row["true_x_m"] is not None]
    scores = _column(found, "score")
    boxes, true_boxes = _boxes(found, ""), _boxes(true, "true_")
    matched = [row for row in found if row["true_x_m"] is not None]
    return {
        "ap_25": average_precision(boxes, scores, true_boxes, 0.25),
        "ap_50": average_precision(boxes, scores, true_boxes, 0.5),
        "mask_iou": float(np.mean(_column(matched, "mask_iou"))) if matched else 0.0,
    } | {
        name: float(np.mean(_column(matched, name))) if matched else float("nan")
        for name in ("centre_mm", "chamfer_mm", "normal_deg")
    }


def view_row(
    perceiver: Perceiver, scene: SceneFeatures, frames: Frames, camera: Camera
) -> PerceptionRow:
    """How good the view predicted for ``camera`` is, against the only image of ``frames``."""
    return {**picture_quality(perceiver.render(scene, camera), frames.rgb_VHW3[0])}


def picture_quality(guess_HW3: NDArray[np.uint8], true_HW3: NDArray[np.uint8]) -> dict[str, float]:
    """``psnr_db`` and ``ssim`` of one picture against another."""
    return image_quality(
        *(
            torch.from_numpy(np.array(image)).movedim(-1, 0).float() / 255
            for image in (guess_HW3, true_HW3)
        )
    )


def _detection(
    box_6: Floats, score: float, true_6: Floats | None, quality: tuple[float, float, float] | None
) -> PerceptionRow:
    """``quality`` of a match: of its mask, of its surface and of that's normals."""
    row = _boxes_row(box_6, true_6) | {"score": score}
    if true_6 is None or quality is None:
        return row
    row |= dict(zip(("mask_iou", "chamfer_mm", "normal_deg"), map(float, quality), strict=True))
    overlap = float(iou(box_6[:3], box_6[3:], true_6[:3], true_6[3:]))
    return row | {"iou": overlap, "centre_mm": float(np.linalg.norm(box_6[:3] - true_6[:3]) * 1e3)}


def _boxes_row(box_6: Floats | None, true_6: Floats | None) -> PerceptionRow:
    row: PerceptionRow = dict.fromkeys(
        ("score", "iou", "centre_mm", "mask_iou", "chamfer_mm", "normal_deg")
    )
    for prefix, values in (("", box_6), ("true_", true_6)):
        for column_i, name in enumerate(BOX):
            row[prefix + name] = None if values is None else float(values[column_i])
    return row


def _boxes(rows: Sequence[PerceptionRow], prefix: str) -> Boxes:
    values = np.stack([_column(rows, prefix + name) for name in BOX], axis=1)
    return Boxes(_column(rows, "episode").astype(np.int64), values[:, :3], values[:, 3:])


def _column(rows: Sequence[PerceptionRow], name: str) -> Floats:
    return np.array([np.nan if row[name] is None else row[name] for row in rows], dtype=np.float64)
