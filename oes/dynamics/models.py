"""Learned models: one graph network and three encodings of objects (paper 3.2, C.1, C.2)."""

from abc import abstractmethod
from dataclasses import replace
from typing import ClassVar

import torch
from torch import Tensor

from oes.config import params
from oes.dynamics import graph
from oes.dynamics.augment import transform_objects
from oes.dynamics.encoders.crop_encoder import CropConfig, CropEncoder, fold
from oes.dynamics.encoders.heightmap_encoder import HeightmapEncoder
from oes.dynamics.encoders.surface_encoder import ContactConfig
from oes.dynamics.graph import GraphFeatures, ObjectState, StepMotion, TipMotion
from oes.dynamics.unroll import DynamicsModel
from oes.objects import Objects, map_tensors

MIRROR_33 = torch.diag(torch.tensor([1.0, -1.0, 1.0]))
POSE_NUMBERS = 12  # rows of world_T_cam


@params
class ImageEncoderConfig:
    """Channels of the stride-2 convolutions, and width of the two layers after them."""

    channels: tuple[int, ...]
    width: int


@params
class NetConfig:
    """Networks of one task: the graph of all models and the encoders of crops, images, surfaces."""

    graph: graph.GraphConfig
    crop: CropConfig
    image: ImageEncoderConfig
    contact: ContactConfig


@params
class InputSpec:
    """Sizes of the perceived ``Objects`` that a network was built for."""

    crop_channels: int
    crop_side: int
    voxel_m: float
    image_side_px: int
    profile_rows: int
    profile_directions: int


class GraphModel(DynamicsModel):
    """A graph network whose node features encode the objects' appearance.

    In eval mode a forecast is the mean of the forecast of the scene and of the mirrored-back
    forecast of its mirror image, which makes it equivariant to mirroring. Training uses mirror
    augmentation instead, at half the cost. ``CAMERAS``: ``random`` cameras or the ``fixed`` one.
    """

    CAMERAS: ClassVar[str] = "random"
    AVERAGES_MIRROR: ClassVar[bool] = True
    USES_CROPS: ClassVar[bool] = False
    USES_IMAGES: ClassVar[bool] = False
    USES_SURFACES: ClassVar[bool] = False

    def __init__(self, net: NetConfig, inputs: InputSpec, node: int = 0, edge: int = 0) -> None:
        super().__init__()
        self.net, self.inputs = net, inputs
        self.graph = graph.GraphNet(net.graph, node, edge)

    @abstractmethod
    def encode(self, objects: Objects) -> Tensor:
        """Appearance BNC of batched objects in the first frame."""

    @abstractmethod
    def step(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Motion of every object over one action, of an appearance from ``encode``."""

    def appearance(self, objects: Objects) -> Tensor:
        """``encode``d objects; followed by their mirror image, BN(2C), if it is averaged over."""
        appearance_BNC = self.encode(objects)
        if self.training or not self.AVERAGES_MIRROR:
            return appearance_BNC
        mirror_B33 = MIRROR_33.to(objects.center_N3).expand(len(appearance_BNC), 3, 3)
        shift_BN3 = torch.zeros_like(objects.center_N3)
        mirror = transform_objects(objects, mirror_B33, shift_BN3, self.inputs.voxel_m)
        return torch.cat([appearance_BNC, self.encode(mirror)], -1)

    def forward(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Motion of every object over one action."""
        if self.training or not self.AVERAGES_MIRROR:
            return self.step(appearance_BNC, state, tip)
        mirror_33 = MIRROR_33.to(state.center_BN3)
        # One batch of 2B scenes: two smaller steps take longer.
        motion = self.step(
            torch.cat(appearance_BNC.chunk(2, -1)),
            map_tensors(state, lambda *x: torch.cat(x), _mirrored(state, mirror_33)),
            map_tensors(tip, lambda x_B3: torch.cat([x_B3, x_B3 @ mirror_33])),
        )
        dp_BN3, mirror_dp_BN3 = motion.dp_BN3.chunk(2)
        rotvec_BN3, mirror_rotvec_BN3 = motion.rotvec_BN3.chunk(2)
        dp_BN3 = (dp_BN3 + mirror_dp_BN3 @ mirror_33) / 2
        # A rotation vector is a pseudovector: mirroring also flips its sign.
        return StepMotion(dp_BN3, (rotvec_BN3 - mirror_rotvec_BN3 @ mirror_33) / 2)


class GraphXYZ(GraphModel):
    """Positions and motions only, no appearance and no orientation."""

    def encode(self, objects: Objects) -> Tensor:
        """A tensor BN0."""
        return objects.center_N3[..., :0]

    def step(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Motion of every object over one action."""
        empty_BN0 = appearance_BNC[..., :0]
        empty_BNN0 = empty_BN0[:, :, None].expand(-1, -1, empty_BN0.shape[1], -1)
        eye_BN33 = torch.eye(3).to(state.rotation_BN33).expand_as(state.rotation_BN33)
        motion: StepMotion = self.graph(
            GraphFeatures(appearance_BNC, empty_BN0, empty_BNN0),
            replace(state, rotation_BN33=eye_BN33),
            tip,
        )
        return motion


class GraphXYZImage(GraphXYZ):
    """Positions, and a 2D CNN on each view's image crop with the camera's pose, mean over views."""

    USES_IMAGES = True

    def __init__(self, net: NetConfig, inputs: InputSpec) -> None:
        image = net.image
        super().__init__(net, inputs, image.width)
        self.convs = graph.conv_encoder(3, image.channels, kernel_px=3)
        flat = image.channels[-1] * (inputs.image_side_px >> len(image.channels)) ** 2
        self.head = graph.mlp(flat + POSE_NUMBERS, image.width, 2)

    def encode(self, objects: Objects) -> Tensor:
        """Mean BNC over the existing views."""
        image_P3HW = objects.image_NV3HW.flatten(0, 2).to(objects.camera_NV12.dtype)
        image_PC = self.convs(image_P3HW / 255 - 0.5)
        image_BNVC = image_PC.reshape(*objects.view_NV.shape, -1)
        view_BNVC = self.head(torch.cat([image_BNVC, objects.camera_NV12], -1))
        sum_BNC: Tensor = (view_BNVC * objects.view_NV[..., None]).sum(-2)
        return sum_BNC / objects.view_NV.sum(-1, keepdim=True).clamp(min=1)


class GraphXYZImageFixed(GraphXYZImage):
    """``GraphXYZImage`` trained and tested on one fixed camera (last block of Table 1)."""

    CAMERAS = "fixed"


class OES(GraphModel):
    """The paper's model: 3D feature crops of the first frame, moved with each object.

    The paper pools them once. Here every step encodes them anew: as slabs where objects are pushed
    (``encoders.crop_encoder``), as height maps where they fall (``encoders.heightmap_encoder``).
    """

    USES_CROPS = True

    def __init__(self, net: NetConfig, inputs: InputSpec) -> None:
        crop, side, voxel_m = net.crop, inputs.crop_side, inputs.voxel_m
        self.is_slabs = crop.encoder == "slabs"
        node, edge = (0, 0) if self.is_slabs else HeightmapEncoder.NUM_SCALARS
        super().__init__(net, inputs, crop.width + node, crop.width + edge)
        self.encoder: CropEncoder | HeightmapEncoder
        if self.is_slabs:
            channels = min(crop.num_channels, inputs.crop_channels) * crop.num_slabs
            self.crop_shape = (channels, side, side)
            self.encoder = CropEncoder(crop, channels, side, side * voxel_m)
        else:
            self.crop_shape = (side, side, side)
            self.encoder = HeightmapEncoder(crop, side, voxel_m, net.graph.unit_m)

    def encode(self, objects: Objects) -> Tensor:
        """Slabs, or occupancies, flattened: BNC in world axes at t = 0."""
        if not self.is_slabs:
            return objects.crop_NCXYZ[:, :, 0].flatten(2)
        crop = self.net.crop
        return fold(objects.crop_NCXYZ[:, :, : crop.num_channels], crop.num_slabs).flatten(2)

    def step(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Motion of every object over one action."""
        crops = torch.unflatten(appearance_BNC, -1, self.crop_shape)
        motion: StepMotion = self.graph(self.encoder(crops, state, tip), state, tip)
        return motion


def _mirrored(state: ObjectState, mirror_33: Tensor) -> ObjectState:
    """State of the mirrored scene; ``mirror_33`` is its own inverse."""
    return replace(
        state,
        center_BN3=state.center_BN3 @ mirror_33,
        velocity_BN3=state.velocity_BN3 @ mirror_33,
        omega_BN3=-state.omega_BN3 @ mirror_33,
        displacement_BN3=state.displacement_BN3 @ mirror_33,
        rotation_BN33=mirror_33 @ state.rotation_BN33 @ mirror_33,
        twist_BN3=state.twist_BN3 * state.twist_BN3.new_tensor([1.0, -1.0, -1.0]),
    )
