"""The learned models: one graph network, three ways of seeing an object (paper section 3.2, appendix C.1-C.2)."""

from itertools import pairwise
from typing import ClassVar, cast

import torch
from torch import Tensor, nn

from oes.config import params
from oes.dynamics.graph import Graph, GraphNet, Motion, ObjectState, heading, mlp
from oes.dynamics.unroll import Model
from oes.objects import Objects

POSE = 12


@params
class CropNet:
    """How crops are read: so many of their channels (the mask is the first), output channels of the three 3D
    convolutions, the angular harmonics of average pooling, and the width of the two layers after it."""

    read: int
    channels: tuple[int, int, int]
    harmonics: int
    width: int


@params
class ImageNet:
    """Output channels of the 2D convolutions (stride 2 each) and the width of the two layers after them."""

    channels: tuple[int, ...]
    width: int


@params
class Net:
    """The networks: the graph that all models share and the two ways of reading appearance."""

    graph: Graph
    crop: CropNet
    image: ImageNet


@params
class Seen:
    """Sizes of what perception delivers, which a network must fit: crop channels, crop side, image side."""

    crop_channels: int
    crop_side: int
    image_side_px: int


class Learned(Model):
    """A graph network with an appearance of some width. ``DRAWS`` names the views it learns from."""

    DRAWS: ClassVar[str] = "random"
    READS_CROPS: ClassVar[bool] = False
    READS_IMAGES: ClassVar[bool] = False

    def __init__(self, net: Net, seen: Seen, appearance: int = 0) -> None:
        super().__init__()
        self.net, self.seen = net, seen
        self.graph = GraphNet(net.graph, appearance)


class GraphXYZ(Learned):
    """Centroids, their motion and nothing of what the objects look like; world axes, no orientation."""

    def appearance(self, objects: Objects) -> Tensor:
        """None: a tensor BN0."""
        return objects.center_N3[..., :0]

    def forward(self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor) -> Motion:
        """Motion of every object over one action."""
        upright = torch.zeros_like(state.center_BN3)
        upright[..., 2] = 1
        return cast(Motion, self.graph(appearance_BNC, state, upright, tip_world_B3, action_B3))


class GraphXYZImage(GraphXYZ):
    """Centroids and a 2D CNN's reading of each view's image crop joined with the camera's pose, averaged over views."""

    READS_IMAGES = True

    def __init__(self, net: Net, seen: Seen) -> None:
        image = net.image
        super().__init__(net, seen, appearance=image.width)
        convs: list[nn.Module] = []
        for fan_in, fan_out in pairwise((3, *image.channels)):
            convs += [_xavier(nn.Conv2d(fan_in, fan_out, 3, stride=2, padding=1)), nn.LeakyReLU(0.01)]
        self.convs = nn.Sequential(*convs, nn.Flatten())
        flat = image.channels[-1] * (seen.image_side_px >> len(image.channels)) ** 2
        self.join = mlp(flat + POSE, image.width, 2)

    def appearance(self, objects: Objects) -> Tensor:
        """BNC: mean over the views that exist."""
        images_P3HW = objects.image_NV3HW.flatten(0, 2)
        read = self.convs(images_P3HW.to(objects.camera_NV12.dtype) / 255 - 0.5)
        read = read.reshape(*objects.image_NV3HW.shape[:3], -1)
        features_BNVC = self.join(torch.cat([read, objects.camera_NV12], -1)) * objects.view_NV[..., None]
        return cast(Tensor, features_BNVC.sum(-2) / objects.view_NV.sum(-1, keepdim=True).clamp(min=1))


class GraphXYZImageFixed(GraphXYZImage):
    """The same, trained and tested on one fixed camera (the last block of the paper's Table 1)."""

    DRAWS = "fixed"


class OES(Learned):
    """The paper's model: 3D feature crops of the first frame, and the orientation of each object since then.

    Average pooling is weighted with the angular harmonics about the crop's vertical (1, cos, sin, cos 2, sin 2, ...),
    so that turning the object turns each pair of pooled features by a multiple of the angle. At every step they are
    turned to the present orientation, as the action sees it, before the two fully connected layers: the features of
    the first frame read as if cropped from the paper's warped scene map, without warping it.
    """

    READS_CROPS = True
    GAIN = 20.0  # an object fills about a twentieth of its crop
    place_2XYZ: Tensor
    harmonics_KXY: Tensor

    def __init__(self, net: Net, seen: Seen) -> None:
        crop = net.crop
        super().__init__(net, seen, appearance=crop.width)
        first, second, third = crop.channels
        self.convs = nn.Sequential(
            _xavier(nn.Conv3d(min(crop.read, seen.crop_channels) + 2, first, 2, stride=2)),
            nn.LeakyReLU(0.01),
            _xavier(nn.Conv3d(first, second, 3, stride=(1, 1, 2), padding=1)),
            nn.LeakyReLU(0.01),
            _xavier(nn.Conv3d(second, third, 3, stride=(1, 1, 2), padding=1)),
            nn.LeakyReLU(0.01),
        )
        self.join = mlp(third * (2 * crop.harmonics + 1), crop.width, 2)
        self.register_buffer("place_2XYZ", _place(seen.crop_side), persistent=False)
        self.register_buffer("harmonics_KXY", _harmonics(seen.crop_side // 2, crop.harmonics), persistent=False)

    def appearance(self, objects: Objects) -> Tensor:
        """BNC: harmonic averages of the convolved crops, in world axes at t = 0."""
        crops_PCXYZ = objects.crop_NCXYZ[:, :, : self.net.crop.read].flatten(0, 1)
        place_P2XYZ = self.place_2XYZ * crops_PCXYZ[:, :1]
        convolved_PCXYZ = self.convs(torch.cat([crops_PCXYZ, place_P2XYZ], 1) * 4)
        pooled_PKC = torch.einsum("pcxy,kxy->pkc", convolved_PCXYZ.mean(-1), self.harmonics_KXY)
        return pooled_PKC.reshape(*objects.crop_NCXYZ.shape[:2], -1) * self.GAIN

    def forward(self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor) -> Motion:
        """Motion of every object over one action."""
        action_angle_B = torch.atan2(action_B3[:, 1], action_B3[:, 0])
        angle_BN = heading(state.turned_BN33) - action_angle_B[:, None]
        seen_BNC = self.join(turned(appearance_BNC, angle_BN, self.net.crop.harmonics))
        return cast(Motion, self.graph(seen_BNC, state, state.turned_BN33[..., 2], tip_world_B3, action_B3))


def turned(pooled_BNC: Tensor, angle_BN: Tensor, harmonics: int) -> Tensor:
    """Harmonic averages (1, cos, sin, cos 2, sin 2, ... each of some channels) of objects turned by ``angle_BN``."""
    pooled_BNKC = pooled_BNC.reshape(*pooled_BNC.shape[:2], 2 * harmonics + 1, -1)
    angle_BNK1 = (angle_BN[..., None] * torch.arange(1, harmonics + 1, device=angle_BN.device))[..., None]
    even, odd = pooled_BNKC[:, :, 1::2], pooled_BNKC[:, :, 2::2]
    cos, sin = angle_BNK1.cos(), angle_BNK1.sin()
    parts = [pooled_BNKC[:, :, :1], even * cos - odd * sin, even * sin + odd * cos]
    return torch.cat(parts, 2).flatten(2)


def _xavier(conv: nn.Conv2d | nn.Conv3d) -> nn.Module:
    """The convolution, Xavier initialised."""
    nn.init.xavier_uniform_(conv.weight)
    nn.init.zeros_(conv.bias)  # type: ignore[arg-type]
    return conv


def _place(side: int) -> Tensor:
    """Coordinate channels 2XYZ: distance from the vertical axis and height over the centre, 1 at the outer faces."""
    line = (torch.arange(side) + 0.5) / side * 2 - 1
    x, y, z = torch.meshgrid(line, line, line, indexing="ij")
    return torch.stack([torch.hypot(x, y), z])


def _harmonics(side: int, count: int) -> Tensor:
    """Weights KXY of a mean over x and y with 1, cos(angle), sin(angle), cos(2 angle), ... of each cell's direction."""
    line = torch.arange(side) + 0.5 - side / 2
    angle_XY = torch.atan2(line[None, :], line[:, None])
    waves = [f(k * angle_XY) for k in range(1, count + 1) for f in (torch.cos, torch.sin)]
    return torch.stack([torch.ones_like(angle_XY), *waves]) / side**2
