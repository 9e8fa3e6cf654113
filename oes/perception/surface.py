"""The completed surface of an object, seen and unseen sides: an outline for every height, read off
a cylinder.

Around the box's vertical axis stand the points of a cylinder: so many directions, distances and
bands of height. The views are lifted exactly at those points, and a network that runs around the
cylinder tells, for each direction and band, how far out the object reaches, how sure that is, and
whether there is any of it. A turn of the scene by one direction turns the answer by one: the
network is equivariant by construction.
"""

from dataclasses import dataclass
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.boxes import base
from oes.geom.polar import directions
from oes.geom.voxels import Grid, sample
from oes.objects import LAYERS

RADIUS, SCALE, PRESENCE = 0, 1, 2  # what is known of it in each direction
NUM_BOX = 3  # channels beside the lifted ones: mask, distance from the axis over the box's size, height over the box's
FOLD = 2  # so many neighbouring distances become channels of one at once
UNIT_M = 0.05
MIN_SIGMA_PROFILE_M = 3e-4
GROUPS = 8
KERNEL_SIZES = (5, 9, 9, 5)  # how many directions wide the blocks around the cylinder are


@params
class Cylinder:
    """Points around an object: ``directions`` x ``distances`` (``step_m`` apart) x ``bands`` (of
    ``band_m``, from the bottom of its box upwards).
    """

    directions: int
    distances: int
    step_m: float
    bands: int
    band_m: float

    @property
    def rows(self) -> int:
        """How many outlines: ``WHOLE``, ``ABOVE``, ``FOOT`` and each band."""
        return LAYERS + self.bands

    @property
    def reach_m(self) -> float:
        """The greatest radius."""
        return self.distances * self.step_m


@params
class SurfaceHeadConfig:
    """The cylinder, and the widths of the network: channels on the cylinder (halved in distance
    after each) and around it; ``column``: of what is read off all distances and bands of one
    direction at once.
    """

    cylinder: Cylinder
    channels: tuple[int, ...]
    width: int
    column: int

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from params.yaml) for distances that cannot be
        halved so often.
        """
        step = FOLD << len(self.channels)
        if self.cylinder.distances % step:
            raise ValueError(
                f"cylinder.distances must be a multiple of {step} for {len(self.channels)} channels; "
                f"found {self.cylinder.distances}"
            )


@dataclass(frozen=True)
class SurfaceOutput:
    """For P objects: radius (metres), its scale (metres; of a Laplace law), presence as a logit,
    each PRK (R rows); and the centre of mass from the box's centre, P3 (metres).
    """

    radius_PRK: Tensor
    scale_PRK: Tensor
    presence_PRK: Tensor
    mass_P3: Tensor

    def outline(self) -> Tensor:
        """PRK3: radius, scale, presence (probability)."""
        return torch.stack([self.radius_PRK, self.scale_PRK, self.presence_PRK.sigmoid()], -1)


class CircularResBlock(nn.Module):
    """A residual block that runs around the cylinder: PCKL (directions, distances), or PCK1."""

    def __init__(self, channels: int, kernel: tuple[int, int]) -> None:
        super().__init__()
        self.margin = (kernel[0] // 2, kernel[1] // 2)
        self.first, self.second = (nn.Conv2d(channels, channels, kernel) for _ in range(2))
        self.norms = nn.ModuleList(nn.GroupNorm(GROUPS, channels) for _ in range(2))
        nn.init.zeros_(self.second.weight)

    def forward(self, x: Tensor) -> Tensor:
        """The same shape."""
        inner = F.relu(self.norms[0](self.first(self._padded(x))))
        return F.relu(self.norms[1](x + self.second(self._padded(inner))))

    def _padded(self, x: Tensor) -> Tensor:
        around, out = self.margin
        x = torch.cat([x[:, :, -around:], x, x[:, :, :around]], 2)
        return F.pad(x, (out, out, 0, 0))


class SurfaceHead(nn.Module):
    """What is lifted at the cylinders of P objects -> ``SurfaceOutput``."""

    points: Tensor

    def __init__(self, cfg: SurfaceHeadConfig, lifted: int) -> None:
        super().__init__()
        self.cfg = cfg
        cylinder = cfg.cylinder
        self.register_buffer("points", cylinder_points(cylinder), persistent=False)
        widths = cfg.channels
        seen = (lifted + NUM_BOX) * cylinder.bands + 1
        self.stem = nn.Conv2d(seen, widths[0], (1, FOLD), stride=(1, FOLD))
        self.blocks = nn.ModuleList(CircularResBlock(width, (3, 3)) for width in widths)
        self.downs = nn.ModuleList(
            nn.Conv2d(a, b, (1, 2), stride=(1, 2)) for a, b in pairwise((*widths, widths[-1]))
        )
        flat = widths[-1] * (cylinder.distances // FOLD >> len(widths))
        self.join = nn.Conv2d(flat, cfg.width, 1)
        self.column = nn.Linear(seen * cylinder.distances, cfg.column)
        self.beside = nn.Conv2d(cfg.column, cfg.width, 1)
        self.context = nn.ModuleList(nn.Conv2d(cfg.width, cfg.width, 1) for _ in KERNEL_SIZES)
        self.rounds = nn.ModuleList(
            CircularResBlock(cfg.width, (kernel, 1)) for kernel in KERNEL_SIZES
        )
        self.out, self.direct = (
            nn.Conv2d(width, 3 * cylinder.rows + 2, 1) for width in (cfg.width, cfg.column)
        )
        nn.init.zeros_(self.out.weight)
        nn.init.zeros_(self.direct.weight)

    def forward(self, inputs_PCKL: Tensor) -> SurfaceOutput:
        """``inputs_PCKL``: what ``inputs`` gives."""
        x = F.relu(self.stem(inputs_PCKL))
        for block, down in zip(self.blocks, self.downs, strict=True):
            x = F.relu(down(block(x)))
        x = self.join(x.movedim(-1, 2).flatten(1, 2)[..., None])
        column_PCK1 = F.relu(self.column(inputs_PCKL.movedim(2, 1).flatten(2))).mT[..., None]
        x = F.relu(x + self.beside(column_PCK1))
        for block, context in zip(self.rounds, self.context, strict=True):
            x = block(x + context(x.mean(2, keepdim=True)))
        # norms take from an object what it is everywhere, such as its height: columns tell that
        # past them
        out_PCK = (self.out(x) + self.direct(column_PCK1))[..., 0].float()
        rows_PR3K = out_PCK[:, :-2].unflatten(1, (self.cfg.cylinder.rows, 3))
        side_P2 = (
            out_PCK[:, -2]
            @ directions(out_PCK.shape[-1], out_PCK.device)
            / out_PCK.shape[-1]
            * UNIT_M
        )
        return SurfaceOutput(
            radius_PRK=F.softplus(rows_PR3K[:, :, RADIUS]) * UNIT_M,
            scale_PRK=F.softplus(rows_PR3K[:, :, SCALE]) * UNIT_M / 10 + MIN_SIGMA_PROFILE_M,
            presence_PRK=rows_PR3K[:, :, PRESENCE],
            mass_P3=torch.cat([side_P2, out_PCK[:, -1:].mean(-1) * UNIT_M], -1),
        )

    @property
    def outputs(self) -> tuple[nn.Module, ...]:
        """What gives the answers: not for Muon (see ``oes.training.loop``)."""
        return self.out, self.direct

    def places(self, centers_P3: Tensor, sizes_P3: Tensor) -> Tensor:
        """World points P(KLB)3 of the cylinders of P boxes."""
        foot_P3 = torch.cat([centers_P3[:, :2], base(centers_P3, sizes_P3)[:, None]], -1)
        return foot_P3[:, None] + self.points.reshape(-1, 3)

    def inputs(
        self,
        lifted_PQC: Tensor,
        mask_PXYZ: Tensor,
        window: Grid,
        boxes: tuple[Tensor, Tensor],
        cameras_PV3: Tensor,
    ) -> Tensor:
        """PCKL for ``forward``: what the views say at ``places``, the mask and where that is in the
        box (centres P3, sizes P3); and how much each direction faces the cameras.
        """
        centers_P3, sizes_P3 = boxes
        offset_PQ3 = self.places(centers_P3, sizes_P3) - centers_P3[:, None]
        mask_PQ1 = sample(mask_PXYZ[:, None].float(), window, offset_PQ3)
        half_P13 = sizes_P3[:, None].clamp(min=1e-3) / 2
        aside_PQ1 = (offset_PQ3 / half_P13)[..., :2].abs().amax(-1, keepdim=True).clamp(max=2)
        up_PQ1 = (offset_PQ3 / half_P13)[..., 2:].clamp(-2, 2)
        all_PQC = torch.cat([lifted_PQC.float(), mask_PQ1, aside_PQ1, up_PQ1], -1)
        cylinder = self.cfg.cylinder
        parts = all_PQC.reshape(
            len(all_PQC), cylinder.directions, cylinder.distances, cylinder.bands, -1
        )
        toward_P3 = F.normalize(cameras_PV3 - centers_P3[:, None], dim=-1).mean(1)
        facing_PK = toward_P3[:, :2] @ directions(cylinder.directions, toward_P3.device).T
        facing_P1KL = facing_PK[:, None, :, None].expand(-1, 1, -1, cylinder.distances)
        return torch.cat([parts.flatten(3).movedim(-1, 1), facing_P1KL], 1)


def cylinder_points(cfg: Cylinder) -> Tensor:
    """KLB3: the middles of a cylinder's cells, from the middle of its foot."""
    distance_L = (torch.arange(cfg.distances) + 0.5) * cfg.step_m
    height_B = (torch.arange(cfg.bands) + 0.5) * cfg.band_m
    side_KL2 = directions(cfg.directions)[:, None] * distance_L[:, None]
    side_KLB2 = side_KL2[:, :, None].expand(-1, -1, cfg.bands, -1)
    return torch.cat([side_KLB2, height_B[:, None].expand(*side_KLB2.shape[:3], 1)], -1)


def scale_profiles(outline_RK3: Tensor, factor: float) -> Tensor:
    """The outlines of an object that is so many times as large, from the same foot upwards; what no
    longer fits into the bands is left out.
    """
    bands_BK3 = outline_RK3[LAYERS:]
    was_B = ((torch.arange(len(bands_BK3)) + 0.5) / factor).long()
    is_known_B = was_B < len(bands_BK3)
    bands_BK3 = bands_BK3[was_B.clamp(max=len(bands_BK3) - 1)] * is_known_B[:, None, None]
    grown = torch.ones(bands_BK3.shape[-1])
    grown[[RADIUS, SCALE]] = factor
    return torch.cat([outline_RK3[:LAYERS], bands_BK3]) * grown
