"""The learned models: one graph network, three ways of seeing an object (paper section 3.2,
appendix C.1-C.2).
"""

from abc import abstractmethod
from typing import ClassVar, cast

import torch
from torch import Tensor

from oes.config import params
from oes.dynamics.augment import transform_objects
from oes.dynamics.encoders.crop_encoder import CropConfig, CropEncoder, fold
from oes.dynamics.encoders.heightmap_encoder import (
    HEIGHTMAP_EDGE_CHANNELS,
    HEIGHTMAP_NODE_CHANNELS,
    HeightmapEncoder,
)
from oes.dynamics.encoders.surface_encoder import ContactConfig
from oes.dynamics.graph import (
    GraphConfig,
    GraphNet,
    ObjectState,
    StepMotion,
    conv_encoder,
    mirrored,
    mlp,
    node_features_only,
)
from oes.dynamics.unroll import DynamicsModel
from oes.objects import Objects

POSE = 12


@params
class ImageEncoderConfig:
    """Output channels of the 2D convolutions (stride 2 each) and the width of the two layers after
    them.
    """

    channels: tuple[int, ...]
    width: int


@params
class NetConfig:
    """The networks: the graph that all models share and the three ways of seeing objects."""

    graph: GraphConfig
    crop: CropConfig
    image: ImageEncoderConfig
    contact: ContactConfig


@params
class InputSpec:
    """Sizes of what perception delivers, which a network must fit: crop channels, side and voxel,
    image side, rows and directions of outlines.
    """

    crop_channels: int
    crop_side: int
    voxel_m: float
    image_side_px: int
    profile_rows: int
    profile_directions: int


class GraphModel(DynamicsModel):
    """A graph network with an appearance of some width. ``DRAWS`` names the views it learns from.

    Out of training, a forecast is the mean of the network's for the scene and for its mirror image,
    mirrored back: mirrored scenes get mirrored forecasts. Training sees mirror images by
    augmentation instead, at half the cost.
    """

    DRAWS: ClassVar[str] = "random"
    READS_CROPS: ClassVar[bool] = False
    READS_IMAGES: ClassVar[bool] = False
    READS_SURFACES: ClassVar[bool] = False
    mirror_33: Tensor

    def __init__(
        self, net: NetConfig, seen: InputSpec, appearance: int = 0, contact: int = 0
    ) -> None:
        super().__init__()
        self.net, self.seen = net, seen
        self.graph = GraphNet(net.graph, appearance, contact)
        self.register_buffer(
            "mirror_33", torch.diag(torch.tensor([1.0, -1.0, 1.0])), persistent=False
        )

    @abstractmethod
    def look(self, objects: Objects) -> Tensor:
        """Appearance BNC of batched objects as first seen."""

    @abstractmethod
    def step(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """Motion of every object over one action."""

    def appearance(self, objects: Objects) -> Tensor:
        """``look`` at the objects and, out of training, at their mirror image, one after the other:
        BN(2C).
        """
        here_BNC = self.look(objects)
        if self.training:
            return here_BNC
        mirror_B33 = self.mirror_33.expand(len(here_BNC), 3, 3)
        there = transform_objects(
            objects, mirror_B33, torch.zeros_like(objects.center_N3), self.seen.voxel_m
        )
        return torch.cat([here_BNC, self.look(there)], -1)

    def forward(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """Motion of every object over one action."""
        if self.training:
            return self.step(appearance_BNC, state, tip_world_B3, action_B3)
        mirror_33, there = self.mirror_33, mirrored(state, self.mirror_33)
        both = ObjectState(
            **{
                name: torch.cat([value, getattr(there, name)])
                for name, value in vars(state).items()
            }
        )
        appearance_ANC = torch.cat(appearance_BNC.chunk(2, -1))
        # A = 2B scenes at once: twice as many small steps would take longer
        found = self.step(
            appearance_ANC, both, _beside(tip_world_B3, mirror_33), _beside(action_B3, mirror_33)
        )
        (dp_BN3, dp_there_BN3), (spin_BN3, spin_there_BN3) = (
            found.dp_BN3.chunk(2),
            found.spin_BN3.chunk(2),
        )
        return StepMotion(
            (dp_BN3 + dp_there_BN3 @ mirror_33) / 2, (spin_BN3 - spin_there_BN3 @ mirror_33) / 2
        )


class GraphXYZ(GraphModel):
    """Centroids, their motion and nothing of what the objects look like; world axes, no
    orientation.
    """

    def look(self, objects: Objects) -> Tensor:
        """None: a tensor BN0."""
        return objects.center_N3[..., :0]

    def step(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """Motion of every object over one action."""
        upright = torch.zeros_like(state.center_BN3)
        upright[..., 2] = 1
        return cast(
            StepMotion,
            self.graph(node_features_only(appearance_BNC), state, upright, tip_world_B3, action_B3),
        )


class GraphXYZImage(GraphXYZ):
    """Centroids and a 2D CNN's reading of each view's image crop joined with the camera's pose,
    averaged over views.
    """

    READS_IMAGES = True

    def __init__(self, net: NetConfig, seen: InputSpec) -> None:
        image = net.image
        super().__init__(net, seen, appearance=image.width)
        self.convs = conv_encoder(3, image.channels, kernel_px=3)
        flat = image.channels[-1] * (seen.image_side_px >> len(image.channels)) ** 2
        self.join = mlp(flat + POSE, image.width, 2)

    def look(self, objects: Objects) -> Tensor:
        """BNC: mean over the views that exist."""
        images_P3HW = objects.image_NV3HW.flatten(0, 2)
        read = self.convs(images_P3HW.to(objects.camera_NV12.dtype) / 255 - 0.5)
        read = read.reshape(*objects.image_NV3HW.shape[:3], -1)
        features_BNVC = (
            self.join(torch.cat([read, objects.camera_NV12], -1)) * objects.view_NV[..., None]
        )
        return cast(
            Tensor, features_BNVC.sum(-2) / objects.view_NV.sum(-1, keepdim=True).clamp(min=1)
        )


class GraphXYZImageFixed(GraphXYZImage):
    """The same, trained and tested on one fixed camera (the last block of the paper's Table 1)."""

    DRAWS = "fixed"


class OES(GraphModel):
    """The paper's model: 3D feature crops of the first frame, carried along with each object.

    The paper reads them once, pooled; here they are read anew at every step: as slabs where objects
    are pushed (see ``oes.dynamics.encoders.crop_encoder``), as height maps where they fall (see
    ``oes.dynamics.encoders.heightmap_encoder``).
    """

    READS_CROPS = True

    def __init__(self, net: NetConfig, seen: InputSpec) -> None:
        crop, side = net.crop, seen.crop_side
        extra = (
            (HEIGHTMAP_NODE_CHANNELS, HEIGHTMAP_EDGE_CHANNELS) if crop.sight == "relief" else (0, 0)
        )
        super().__init__(net, seen, appearance=crop.width + extra[0], contact=crop.width + extra[1])
        channels = min(crop.read, seen.crop_channels) * crop.slabs
        self.shape = (channels, side, side) if crop.sight == "slabs" else (side, side, side)
        self.sight: CropEncoder | HeightmapEncoder
        if crop.sight == "slabs":
            self.sight = CropEncoder(crop, channels, side, side * seen.voxel_m)
        else:
            self.sight = HeightmapEncoder(crop, side, seen.voxel_m, net.graph.unit_m)

    def look(self, objects: Objects) -> Tensor:
        """BNC: the crops' slabs, or their masks, flattened, in world axes at t = 0."""
        crop = self.net.crop
        if crop.sight == "relief":
            return objects.crop_NCXYZ[:, :, 0].flatten(2)
        return fold(objects.crop_NCXYZ[:, :, : crop.read], crop.slabs).flatten(2)

    def step(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """Motion of every object over one action."""
        first = appearance_BNC.reshape(*appearance_BNC.shape[:2], *self.shape)
        if isinstance(self.sight, HeightmapEncoder):
            sight = self.sight(first, state, action_B3)
        else:
            sight = self.sight(first, state, tip_world_B3, action_B3)
        return cast(
            StepMotion, self.graph(sight, state, state.turned_BN33[..., 2], tip_world_B3, action_B3)
        )


def _beside(x_B3: Tensor, mirror_33: Tensor) -> Tensor:
    """Vectors and, after them, their mirror images."""
    return torch.cat([x_B3, x_B3 @ mirror_33])
