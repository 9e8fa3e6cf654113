"""The second stage: around each proposed box, the mask of the whole object, a better box, and a
score.

The views are lifted again at the proposal's own voxels (no resampling of a volume), beside the
coarse scene features.
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
    """A crop of ``count``^3 voxels of ``voxel_m``; the net works on 2x2x2 blocks of it."""

    count: int
    voxel_m: float
    channels: tuple[int, ...]
    blocks: tuple[int, ...]
    hidden: int


@dataclass(frozen=True)
class RoiOutput:
    """For B scenes of K regions: mask logits BKXYZ, box deltas BK6 (see ``detector.apply_deltas``),
    score logits BK.
    """

    mask_BKXYZ: Tensor
    deltas_BK6: Tensor
    score_BK: Tensor


class RoiHead(nn.Module):
    """Regions (centre, size) of lifted views and coarse features -> ``RoiOutput``."""

    offsets: Tensor

    def __init__(self, cfg: RoiConfig, lift_cfg: LiftConfig, lifted: int, context: int) -> None:
        super().__init__()
        self.window, self.lift_cfg = cube(cfg.count, cfg.voxel_m), lift_cfg
        self.register_buffer("offsets", fold_order(centers(self.window)), persistent=False)
        self.net = UNet(8 * lifted + context + 2, cfg.channels, cfg.blocks)
        self.mask = nn.Conv3d(cfg.channels[0], 8, 1)
        self.shrink = nn.Conv3d(cfg.channels[0], cfg.channels[0], 2, stride=2)
        self.box = nn.Sequential(
            nn.Linear(cfg.channels[0] * (cfg.count // 4) ** 3, cfg.hidden),
            nn.ReLU(),
            nn.Linear(cfg.hidden, BOX_CHANNELS + 1),
        )

    def forward(
        self,
        views: Views,
        features_BVHWC: Tensor,
        coarse_BCXYZ: Tensor,
        grid: Grid,
        boxes: tuple[Tensor, Tensor],
    ) -> RoiOutput:
        """``grid`` is the one of ``coarse_BCXYZ``; ``boxes`` holds centres BK3 and sizes BK3 of the
        regions.
        """
        batch, count = boxes[0].shape[:2]
        x = self.net(self._inputs(views, features_BVHWC, coarse_BCXYZ, grid, boxes))
        mask = unfold(self.mask(x)).float().reshape(batch, count, *self.window.shape)
        out = self.box(F.relu(self.shrink(x)).flatten(1)).float().reshape(batch, count, -1)
        return RoiOutput(
            mask_BKXYZ=mask, deltas_BK6=out[..., :BOX_CHANNELS], score_BK=out[..., BOX_CHANNELS]
        )

    def _inputs(
        self,
        views: Views,
        features_BVHWC: Tensor,
        coarse_BCXYZ: Tensor,
        grid: Grid,
        boxes: tuple[Tensor, Tensor],
    ) -> Tensor:
        """(BK)CXYZ at half the window's resolution: folded lift, sampled context, inside-the-box
        measure, height.
        """
        centers_BK3, sizes_BK3 = boxes
        batch, count = centers_BK3.shape[:2]
        side = self.offsets.shape[:3]
        points = centers_BK3[:, :, None, None, None, None] + self.offsets
        lifted = lift(self.lift_cfg, views, features_BVHWC, points.reshape(batch, -1, 3))
        middles = points.mean(dim=-2)
        context = sample(coarse_BCXYZ.float(), grid, middles.reshape(batch, -1, 3))
        inside = (
            (middles - centers_BK3[:, :, None, None, None]).abs()
            / sizes_BK3[:, :, None, None, None]
        ).amax(-1)
        extra = torch.stack([inside.clamp(max=1.0), middles[..., 2] / HEIGHT_UNIT_M], dim=-1)
        parts = [
            part.reshape(batch * count, *side, -1).to(lifted.dtype)
            for part in (lifted, context, extra)
        ]
        return torch.cat(parts, dim=-1).movedim(-1, 1)
