"""Axis-aligned boxes in world axes, given as centre ...3 and size ...3; numpy arrays and torch
tensors alike.
"""

import numpy as np
import torch
from torch import Tensor

from oes.episode import Floats
from oes.geom.se3 import Array

STANDS_M = (
    0.012  # more than boxes err by, less than anything is tall that something else could stand on
)


def hull(points_P3: Floats) -> tuple[Floats, Floats]:
    """Centre and size of the smallest axis-aligned box around points ...P3."""
    low, high = points_P3.min(axis=-2), points_P3.max(axis=-2)
    return (low + high) / 2, high - low


def iou(center_a: Array, size_a: Array, center_b: Array, size_b: Array) -> Array:
    """Intersection over union of boxes, broadcast over the leading axes; 0 for disjoint or empty
    boxes.
    """
    minimum, maximum = (
        (torch.minimum, torch.maximum) if isinstance(center_a, Tensor) else (np.minimum, np.maximum)
    )
    high = minimum(center_a + size_a / 2, center_b + size_b / 2)
    low = maximum(center_a - size_a / 2, center_b - size_b / 2)
    shared = (high - low).clip(0).prod(-1)
    overlap: Array = shared / (size_a.prod(-1) + size_b.prod(-1) - shared).clip(1e-12)
    return overlap


def base(center_3: Tensor, size_3: Tensor) -> Tensor:
    """Heights ... of the bottoms of boxes over a table at z = 0: what seems to begin less than
    ``STANDS_M`` above it, or below it, stands on it.
    """
    low = center_3[..., 2] - size_3[..., 2] / 2
    return torch.where(low < STANDS_M, 0, low)
