"""Errors of predicted poses, surfaces, boxes and uncertainties."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from oes.episode import Floats, Ints
from oes.geom.boxes import iou

MIN_ERROR = 1e-3


def translation_mm(predicted_3: Floats, true_3: Floats) -> Floats:
    """Euclidean distances ... (mm) of points ...3 given in metres."""
    return np.asarray(np.linalg.norm(predicted_3 - true_3, axis=-1) * 1e3)


def rotation_deg(predicted_33: Floats, true_33: Floats) -> Floats:
    """Geodesic angles ... (degrees, 0 to 180) between rotation matrices ...33."""
    # From the chord, as the usual arccos of the trace loses small angles to rounding.
    half_chord = np.linalg.norm(predicted_33 - true_33, axis=(-2, -1)) / 8**0.5
    return np.asarray(np.degrees(2 * np.arcsin(np.clip(half_chord, 0, 1))))


def surface_mm(predicted_TQ3: Floats, surface_P3: Floats) -> Floats:
    """Mean distance T (mm) of predicted surface points to the true surface (metres, one frame).

    ADD-S of Hinterstoisser et al. 2012: rotations about a symmetry axis are no error, up to about
    half the spacing of the P samples.
    """
    distance_TQ, _ = KDTree(surface_P3).query(predicted_TQ3)
    return np.asarray(np.mean(distance_TQ, axis=-1) * 1e3)


def chamfer_mm(predicted_P3: Floats, true_Q3: Floats) -> float:
    """Symmetric Chamfer distance (mm) of two point clouds in metres: mean over both directions."""
    to_true_P, _ = KDTree(true_Q3).query(predicted_P3)
    to_predicted_Q, _ = KDTree(predicted_P3).query(true_Q3)
    return float((np.mean(to_true_P) + np.mean(to_predicted_Q)) / 2 * 1e3)


def normal_deg(
    predicted_P3: Floats, predicted_normal_P3: Floats, true_Q3: Floats, true_normal_Q3: Floats
) -> float:
    """Mean angle (degrees) between unit normals and those of the nearest true points."""
    _, nearest_P = KDTree(true_Q3).query(predicted_P3)
    cosine_P = (predicted_normal_P3 * true_normal_Q3[nearest_P]).sum(-1)
    return float(np.degrees(np.arccos(np.clip(cosine_P, -1, 1))).mean())


def error_quantile(level: float, sigma: Floats, dof: float) -> Floats:
    """Quantiles ... of the norm of a 2D Student t with scales ``sigma``.

    P(|e| < r) = 1 - (1 + r^2 / (dof sigma^2))^(-dof / 2).
    """
    return np.asarray(sigma) * float(np.sqrt(dof * ((1 - level) ** (-2 / dof) - 1)))


def error_nll(error: Floats, sigma: Floats, dof: float) -> Floats:
    """Negative log-likelihoods ... of error norms under the law of ``error_quantile``.

    Its density is (r / sigma^2) (1 + r^2 / (dof sigma^2))^(-(dof + 2) / 2). Errors below
    ``MIN_ERROR`` count as ``MIN_ERROR``, as the density vanishes at 0.
    """
    r, s = np.maximum(error, MIN_ERROR), np.asarray(sigma)
    return np.asarray(-np.log(r / s**2) + (dof + 2) / 2 * np.log1p((r / s) ** 2 / dof))


@dataclass(frozen=True)
class Boxes:
    """Axis-aligned boxes of many scenes: scene index, centre and size (metres)."""

    scene_P: Ints
    center_P3: Floats
    size_P3: Floats


def average_precision(predicted: Boxes, score_P: Floats, true: Boxes, min_iou: float) -> float:
    """Area under the all-point interpolated precision-recall curve of 3D boxes.

    Detections of all scenes are ranked together by score; each is matched to the free true box of
    its scene with the largest IoU, if that is at least ``min_iou``. Raises ValueError without true
    boxes.
    """
    if len(true.scene_P) == 0:
        raise ValueError("average precision needs at least one true box")
    order = np.argsort(-score_P, kind="stable")
    is_taken, is_hit = np.zeros(len(true.scene_P), dtype=bool), np.zeros(len(order), dtype=bool)
    for rank, i in enumerate(order):
        free = np.flatnonzero((true.scene_P == predicted.scene_P[i]) & ~is_taken)
        if len(free):
            box = predicted.center_P3[i], predicted.size_P3[i]
            overlap = iou(*box, true.center_P3[free], true.size_P3[free])
            best = int(np.argmax(overlap))
            is_taken[free[best]] = is_hit[rank] = overlap[best] >= min_iou
    precision = np.cumsum(is_hit) / np.arange(1, len(order) + 1)
    interpolated = np.maximum.accumulate(precision[::-1])[::-1]
    return float(np.sum(interpolated[is_hit]) / len(true.scene_P))
