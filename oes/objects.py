"""What perception tells dynamics about the objects of a scene; the border between the two."""

from dataclasses import dataclass

import torch
from torch import Tensor

# rows of an outline: of all bands; of all but the lowest; of what the object stands on; then the
# bands, upwards
UNION, UPPER, SUPPORT, LAYERS = range(4)


@dataclass(frozen=True)
class Objects:
    """N perceived objects in world coordinates; every tensor may carry a leading batch B (then
    ``valid_BN``).

    ``crop_NCXYZ``: C x 16 x 16 x 16 native-voxel crop centred at ``center_N3``, axis-aligned with
    the world. Channel 0 is the probability that a voxel belongs to the whole object (seen and
    unseen side); the others (see ``oes.perception.perceiver.Perceiver.crops``) fade out a voxel off
    it: no robot, no neighbour shows. ``image_NV3HW``: uint8 RGB crop around the projected box in
    every input view; views that do not exist are zero, with ``view_NV`` False. ``camera_NV12``: the
    rows of world_T_cam (3x4) of every view. ``outline_NRK3``: the completed surface as R outlines
    around the vertical through the centre (see ``oes.perception.surface``): radius and its scale
    (metres) in K directions, and how likely there is any of it. ``mass_N3``: where the centre of
    mass is thought to be, from ``center_N3``.
    """

    center_N3: Tensor
    size_N3: Tensor
    score_N: Tensor
    valid_N: Tensor
    crop_NCXYZ: Tensor
    image_NV3HW: Tensor
    camera_NV12: Tensor
    view_NV: Tensor
    outline_NRK3: Tensor
    mass_N3: Tensor

    def to(self, *args: torch.device | torch.dtype) -> "Objects":
        """Move or cast every tensor (integer and bool tensors keep their dtype when a float dtype
        is given).
        """
        return Objects(
            **{
                name: value.to(*args)
                if value.is_floating_point()
                else value.to(*[a for a in args if not isinstance(a, torch.dtype)])
                for name, value in vars(self).items()
            }
        )
