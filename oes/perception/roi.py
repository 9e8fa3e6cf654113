"""Second stage: the amodal mask, a refined box and a score for every proposed box.

The views are lifted again at the voxels of each region, which avoids resampling a volume.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.voxels import Grid, centers, cube, fold_order, sample, unfold
from oes.perception.blocks import UNet
from oes.perception.detector import BOX_CHANNELS
from oes.perception.lift import LiftConfig, Views, lift

HEIGHT_UNIT_M = 0.1


@params
class RoiConfig:
    """A region has ``count``^3 voxels of ``voxel_m``; the network works on 2x2x2 blocks of it."""

    count: int
    voxel_m: float
    channels: tuple[int, ...]
    blocks: tuple[int, ...]
    hidden: int


@dataclass(frozen=True)
class RoiOutput:
    """N regions of each of B scenes: mask and score logits, and deltas for ``apply_deltas``."""

    mask_BNXYZ: Tensor
    deltas_BN6: Tensor
    score_BN: Tensor


class RoiHead(nn.Module):
    """Maps lifted views and coarse scene features in regions to ``RoiOutput``."""

    offsets: Tensor

    def __init__(self, cfg: RoiConfig, lift_cfg: LiftConfig, lifted: int, context: int) -> None:
        super().__init__()
        self.window, self.lift_cfg = cube(cfg.count, cfg.voxel_m), lift_cfg
        self.register_buffer("offsets", fold_order(centers(self.window)), persistent=False)
        width = cfg.channels[0]
        self.net = UNet(8 * lifted + context + 2, cfg.channels, cfg.blocks)
        self.mask = nn.Conv3d(width, 8, 1)
        self.shrink = nn.Conv3d(width, width, 2, stride=2)
        self.box = nn.Sequential(
            nn.Linear(width * (cfg.count // 4) ** 3, cfg.hidden),
            nn.ReLU(),
            nn.Linear(cfg.hidden, BOX_CHANNELS + 1),
        )

    def forward(
        self,
        views: Views,
        features_BVHWC: Tensor,
        coarse: tuple[Tensor, Grid],
        boxes: tuple[Tensor, Tensor],
    ) -> RoiOutput:
        """``coarse``: scene features BCXYZ and their grid. ``boxes``: centres BN3, sizes BN3."""
        batch, count = boxes[0].shape[:2]
        center, size = (value[:, :, None, None, None] for value in boxes)
        points = center[..., None, :] + self.offsets
        lifted = lift(self.lift_cfg, views, features_BVHWC, points.reshape(batch, -1, 3))
        blocks = points.mean(dim=-2)
        context = sample(coarse[0].float(), coarse[1], blocks.reshape(batch, -1, 3))
        # The proposed size enters only here: the window itself has a fixed scale.
        in_box = ((blocks - center).abs() / size).amax(-1)
        extra = torch.stack([in_box.clamp(max=1.0), blocks[..., 2] / HEIGHT_UNIT_M], dim=-1)
        shape = (batch * count, *self.offsets.shape[:3], -1)
        parts = [x.reshape(shape).to(lifted.dtype) for x in (lifted, context, extra)]
        x = self.net(torch.cat(parts, dim=-1).movedim(-1, 1))
        mask = unfold(self.mask(x)).float().reshape(batch, count, *self.window.shape)
        out = self.box(F.relu(self.shrink(x)).flatten(1)).float().reshape(batch, count, -1)
        return RoiOutput(mask, out[..., :BOX_CHANNELS], out[..., BOX_CHANNELS])
