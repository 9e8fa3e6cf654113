"""Axis-aligned boxes as centre ...3 and size ...3, in numpy and torch alike."""

import numpy as np
import torch
from torch import Tensor

from oes.episode import Floats
from oes.geom.se3 import Array

SNAP_M = 0.012  # above the error of a detected box, below the height of anything to stand on


def aabb(points_P3: Floats) -> tuple[Floats, Floats]:
    """Centre and size of the axis-aligned bounding box of points ...P3."""
    low, high = points_P3.min(axis=-2), points_P3.max(axis=-2)
    return (low + high) / 2, high - low


def iou(center_a: Array, size_a: Array, center_b: Array, size_b: Array) -> Array:
    """Intersection over union ... of boxes (broadcast); 0 for disjoint or empty ones."""
    minimum, maximum = (
        (torch.minimum, torch.maximum) if isinstance(center_a, Tensor) else (np.minimum, np.maximum)
    )
    high = minimum(center_a + size_a / 2, center_b + size_b / 2)
    low = maximum(center_a - size_a / 2, center_b - size_b / 2)
    intersection = (high - low).clip(0).prod(-1)
    union = size_a.prod(-1) + size_b.prod(-1) - intersection
    ratio: Array = intersection / union.clip(1e-12)
    return ratio


def support_height(center_3: Tensor, size_3: Tensor) -> Tensor:
    """Heights ... of the bottoms of boxes; those below ``SNAP_M`` stand on the table at 0."""
    bottom = center_3[..., 2] - size_3[..., 2] / 2
    return torch.where(bottom < SNAP_M, 0, bottom)
