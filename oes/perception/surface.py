"""Completed surface of an object as a radial profile: a radius per height layer and direction.

A cylindrical grid (directions x radii x layers) stands around the vertical axis of the box. The
views are lifted to its points, and a network that is circular in the direction predicts for each
direction and layer the radius of the surface, its scale and whether there is any surface. Turning
the scene by one direction turns the prediction by one: the network is equivariant by construction.

Axes of the grid in shapes: D directions, X radii, Z layers.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.boxes import support_height
from oes.geom.polar import directions
from oes.geom.voxels import Grid, sample
from oes.objects import LAYERS

RADIUS, SCALE, PRESENCE = 0, 1, 2  # last axis of a radial profile
NUM_BOX = 3  # inputs beside the lifted ones: mask, and the position relative to the box (2)
RADIAL_STRIDE = 2
UNIT_M = 0.05
MIN_RADIUS_SCALE_M = 3e-4
GROUPS = 8
KERNEL_SIZES = (5, 9, 9, 5)  # of the circular blocks, in directions


@params
class Cylinder:
    """A cylindrical grid; its layers begin at the bottom of the box."""

    num_directions: int
    num_radii: int
    radial_step_m: float
    num_layers: int
    layer_height_m: float

    @property
    def num_rows(self) -> int:
        """Rows of a radial profile: ``UNION``, ``UPPER``, ``SUPPORT`` and every layer."""
        return LAYERS + self.num_layers

    @property
    def max_radius_m(self) -> float:
        """Radius of the grid."""
        return self.num_radii * self.radial_step_m


@params
class SurfaceHeadConfig:
    """The grid and the widths of the network.

    ``channels``: of the convolutions over directions and radii, which halve the radii each.
    ``width``: channels of the circular blocks. ``direction_features``: of the linear layer over all
    radii and layers of one direction.
    """

    cylinder: Cylinder
    channels: tuple[int, ...]
    width: int
    direction_features: int

    def __post_init__(self) -> None:
        """Raises ValueError unless the number of radii can be halved for all ``channels``."""
        stride, num_radii = RADIAL_STRIDE << len(self.channels), self.cylinder.num_radii
        if num_radii % stride:
            raise ValueError(
                f"cylinder.num_radii must be a multiple of {stride} for "
                f"{len(self.channels)} channels; found {num_radii}"
            )


@dataclass(frozen=True)
class SurfaceOutput:
    """Prediction for P objects (metres).

    ``scale_PRD`` is that of a Laplace distribution of the radius; ``com_offset_P3`` is the centre
    of mass relative to the box's centre.
    """

    radius_PRD: Tensor
    scale_PRD: Tensor
    presence_logit_PRD: Tensor
    com_offset_P3: Tensor

    def radial_profile(self) -> Tensor:
        """PRD3: radius, scale, presence probability."""
        return torch.stack([self.radius_PRD, self.scale_PRD, self.presence_logit_PRD.sigmoid()], -1)


class CircularResBlock(nn.Module):
    """Residual block over PCDX (X may be 1) with circular padding of the directions."""

    def __init__(self, channels: int, kernel: tuple[int, int]) -> None:
        super().__init__()
        self.padding = (kernel[0] // 2, kernel[1] // 2)
        self.first, self.second = (nn.Conv2d(channels, channels, kernel) for _ in range(2))
        self.norms = nn.ModuleList(nn.GroupNorm(GROUPS, channels) for _ in range(2))
        # Zero weights make the block an identity at the start, which stabilises early steps.
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """Features of the same shape."""
        inner = F.relu(self.norms[0](self.first(self._padded(x))))
        return F.relu(self.norms[1](x + self.second(self._padded(inner))))

    def _padded(self, x: Tensor) -> Tensor:
        circular, radial = self.padding
        x = torch.cat([x[:, :, -circular:], x, x[:, :, :circular]], 2)
        return F.pad(x, (radial, radial, 0, 0))


class SurfaceHead(nn.Module):
    """Maps features on the cylindrical grids of P objects to ``SurfaceOutput``."""

    points: Tensor

    def __init__(self, cfg: SurfaceHeadConfig, lifted: int) -> None:
        super().__init__()
        self.cfg = cfg
        cylinder, channels, width = cfg.cylinder, cfg.channels, cfg.width
        self.register_buffer("points", cylinder_points(cylinder), persistent=False)
        num_inputs = (lifted + NUM_BOX) * cylinder.num_layers + 1
        stride = (1, RADIAL_STRIDE)
        self.stem = nn.Conv2d(num_inputs, channels[0], stride, stride=stride)
        self.blocks = nn.ModuleList(CircularResBlock(count, (3, 3)) for count in channels)
        self.downs = nn.ModuleList(
            nn.Conv2d(a, b, (1, 2), stride=(1, 2)) for a, b in pairwise((*channels, channels[-1]))
        )
        flat = channels[-1] * (cylinder.num_radii // RADIAL_STRIDE >> len(channels))
        self.radial_proj = nn.Conv2d(flat, width, 1)
        self.direction_encoder = nn.Linear(num_inputs * cylinder.num_radii, cfg.direction_features)
        self.direction_proj = nn.Conv2d(cfg.direction_features, width, 1)
        self.context = nn.ModuleList(nn.Conv2d(width, width, 1) for _ in KERNEL_SIZES)
        self.circular_blocks = nn.ModuleList(CircularResBlock(width, (k, 1)) for k in KERNEL_SIZES)
        num_outputs = 3 * cylinder.num_rows + 2
        self.head = nn.Conv2d(width, num_outputs, 1)
        self.skip_head = nn.Conv2d(cfg.direction_features, num_outputs, 1)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.skip_head.weight)

    def forward(self, inputs_PCDX: Tensor) -> SurfaceOutput:
        """Prediction from ``inputs``."""
        x = F.relu(self.stem(inputs_PCDX))
        for block, down in zip(self.blocks, self.downs, strict=True):
            x = F.relu(down(block(x)))
        x = self.radial_proj(x.movedim(-1, 2).flatten(1, 2)[..., None])
        encoded_PDC = F.relu(self.direction_encoder(inputs_PCDX.movedim(2, 1).flatten(2)))
        skip_PCD1 = encoded_PDC.mT[..., None]
        x = F.relu(x + self.direction_proj(skip_PCD1))
        for block, context in zip(self.circular_blocks, self.context, strict=True):
            x = block(x + context(x.mean(2, keepdim=True)))
        # GroupNorm removes features that are constant over an object, such as its height; the skip
        # connection restores them.
        out_PCD = (self.head(x) + self.skip_head(skip_PCD1))[..., 0].float()
        rows_PR3D = out_PCD[:, :-2].unflatten(1, (self.cfg.cylinder.num_rows, 3))
        # An equivariant vector: the mean over directions of unit vectors times a scalar.
        count = out_PCD.shape[-1]
        xy_P2 = out_PCD[:, -2] @ directions(count, out_PCD.device) / count * UNIT_M
        return SurfaceOutput(
            radius_PRD=F.softplus(rows_PR3D[:, :, RADIUS]) * UNIT_M,
            scale_PRD=F.softplus(rows_PR3D[:, :, SCALE]) * UNIT_M / 10 + MIN_RADIUS_SCALE_M,
            presence_logit_PRD=rows_PR3D[:, :, PRESENCE],
            com_offset_P3=torch.cat([xy_P2, out_PCD[:, -1:].mean(-1) * UNIT_M], -1),
        )

    @property
    def outputs(self) -> tuple[nn.Module, ...]:
        """Output layers, which Muon does not train (see ``oes.training.loop``)."""
        return self.head, self.skip_head

    def world_points(self, center_P3: Tensor, size_P3: Tensor) -> Tensor:
        """Points P(DXZ)3 of the grids of P boxes."""
        return support_points(center_P3, size_P3)[:, None] + self.points.reshape(-1, 3)

    def inputs(
        self,
        lifted_PQC: Tensor,
        mask_PXYZ: Tensor,
        window: Grid,
        boxes: tuple[Tensor, Tensor],
        cameras_PV3: Tensor,
    ) -> Tensor:
        """Inputs PCDX of ``forward``.

        ``lifted_PQC``: features at ``world_points``. ``mask_PXYZ``: on ``window``. ``boxes``:
        centres P3, sizes P3. ``cameras_PV3``: positions of the cameras.
        """
        center_P3, size_P3 = boxes
        offset_PQ3 = self.world_points(*boxes) - center_P3[:, None]
        mask_PQ1 = sample(mask_PXYZ[:, None].float(), window, offset_PQ3)
        in_box_PQ3 = offset_PQ3 / (size_P3[:, None].clamp(min=1e-3) / 2)
        # The largest of |x| and |y| is 1 on the sides of the box.
        lateral_PQ1 = in_box_PQ3[..., :2].abs().amax(-1, keepdim=True).clamp(max=2)
        height_PQ1 = in_box_PQ3[..., 2:].clamp(-2, 2)
        all_PQC = torch.cat([lifted_PQC.float(), mask_PQ1, lateral_PQ1, height_PQ1], -1)
        parts_PDXZC = all_PQC.reshape(len(all_PQC), *self.points.shape[:3], -1)
        to_camera_P3 = F.normalize(cameras_PV3 - center_P3[:, None], dim=-1).mean(1)
        unit_D2 = directions(len(self.points), to_camera_P3.device)
        facing_PD = to_camera_P3[:, :2] @ unit_D2.T
        facing_P1DX = facing_PD[:, None, :, None].expand(-1, 1, -1, self.points.shape[1])
        return torch.cat([parts_PDXZC.flatten(3).movedim(-1, 1), facing_P1DX], 1)


def support_points(center_N3: Tensor, size_N3: Tensor) -> Tensor:
    """Origins N3 of the grids of boxes: below the centre, at the height of the bottom."""
    return torch.cat([center_N3[:, :2], support_height(center_N3, size_N3)[:, None]], -1)


def cylinder_points(cfg: Cylinder) -> Tensor:
    """DXZ3: centres of the cells of a grid, relative to its origin."""
    radius_X = (torch.arange(cfg.num_radii) + 0.5) * cfg.radial_step_m
    height_Z = (torch.arange(cfg.num_layers) + 0.5) * cfg.layer_height_m
    xy_DX2 = directions(cfg.num_directions)[:, None] * radius_X[:, None]
    xy_DXZ2 = xy_DX2[:, :, None].expand(-1, -1, cfg.num_layers, -1)
    return torch.cat([xy_DXZ2, height_Z[:, None].expand(*xy_DXZ2.shape[:3], 1)], -1)


def scale_profiles(radial_profile_RD3: Tensor, factor: float) -> Tensor:
    """Radial profile of an object that is scaled about its support point.

    Layers above the last one of the grid are dropped.
    """
    layer_ZD3 = radial_profile_RD3[LAYERS:]
    source_Z = ((torch.arange(len(layer_ZD3)) + 0.5) / factor).long()
    is_known_Z = source_Z < len(layer_ZD3)
    layer_ZD3 = layer_ZD3[source_Z.clamp(max=len(layer_ZD3) - 1)] * is_known_Z[:, None, None]
    scale_3 = torch.ones(3)
    scale_3[[RADIUS, SCALE]] = factor
    return torch.cat([radial_profile_RD3[:LAYERS], layer_ZD3]) * scale_3
