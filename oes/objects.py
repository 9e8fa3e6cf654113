"""Objects of a scene as perception describes them to dynamics."""

from collections.abc import Callable
from dataclasses import dataclass, is_dataclass
from typing import Any, TypeVar

import torch
from torch import Tensor

# Rows of a radial profile: union of all layers, union of all but the lowest, contour of the support
# on the table, then every layer from the lowest up.
UNION, UPPER, SUPPORT, LAYERS = range(4)

TensorFields = TypeVar("TensorFields")


def map_tensors(x: TensorFields, fn: Callable[..., Tensor], *others: TensorFields) -> TensorFields:
    """Copy of dataclass ``x`` with every tensor field replaced by ``fn(field, *fields of others)``.

    ``map_tensors(a, lambda *t: torch.cat(t), b)`` concatenates two batches. Fields that are
    dataclasses are copied alike; None stays None.
    """

    def mapped(*values: Any) -> Any:
        if values[0] is None:
            return None
        return map_tensors(values[0], fn, *values[1:]) if is_dataclass(values[0]) else fn(*values)

    columns = {name: [getattr(each, name) for each in (x, *others)] for name in vars(x)}
    return type(x)(**{name: mapped(*values) for name, values in columns.items()})


@dataclass(frozen=True)
class Objects:
    """N perceived objects in world coordinates. Tensors may carry a leading B (then ``valid_BN``).

    ``crop_NCXYZ``: features of the 16 x 16 x 16 native voxels around ``center_N3``, axis-aligned
    with the world. Channel 0 is the occupancy probability of the whole object, visible or not; the
    other channels are masked to the object (see ``oes.perception.perceiver.Perceiver.crops``).
    ``image_NV3HW``: uint8 RGB crops around the projected box, zero in missing views.
    ``camera_NV12``: the rows of world_T_cam (3x4) of every view. ``view_NV``: views that exist.
    ``radial_profile_NRD3``: the completed surface as R rows (see ``UNION``) of radius (metres),
    its scale (metres) and its existence probability in D directions around the vertical through the
    centre (see ``oes.perception.surface``). ``com_offset_N3``: predicted centre of mass relative to
    ``center_N3``.
    """

    center_N3: Tensor
    size_N3: Tensor
    score_N: Tensor
    valid_N: Tensor
    crop_NCXYZ: Tensor
    image_NV3HW: Tensor
    camera_NV12: Tensor
    view_NV: Tensor
    radial_profile_NRD3: Tensor
    com_offset_N3: Tensor

    def to(self, *args: torch.device | torch.dtype) -> "Objects":
        """Move or cast every tensor; a dtype applies to floating-point tensors only."""
        devices = [arg for arg in args if not isinstance(arg, torch.dtype)]
        return map_tensors(self, lambda t: t.to(*args if t.is_floating_point() else devices))
