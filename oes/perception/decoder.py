"""View prediction: volume rendering of the feature map from any camera and a 2D decoder.

A coarser background field, lifted from the same views, surrounds the scene map; it holds most of
the arm.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.voxels import Grid, centers, fold_order, unfold
from oes.perception import rays
from oes.perception.blocks import UNet
from oes.perception.lift import NUM_GEOMETRY, LiftConfig, Views, lift
from oes.perception.rays import Field, Rays

NUM_RAY_CHANNELS = 8  # opacity, distance, origin (3), direction (3)
MIN_OPACITY = 1e-3
DENSE_LOGIT = 10.0
PRIOR_GAIN = 10.0  # a voxel of the prior has few gradients, so it needs larger steps than a weight


@params
class BackgroundConfig:
    """A coarse map of the surroundings of the scene map, from its own U-Net on 2x2x2 blocks."""

    grid: Grid
    lift: LiftConfig
    channels: tuple[int, ...]
    blocks: tuple[int, ...]
    num_samples: int


@params
class DecoderConfig:
    """One ray per ``stride_px`` x ``stride_px`` pixels.

    A ray has ``num_samples`` samples in the scene map and ``background.num_samples`` each before
    and after it.
    """

    stride_px: int
    num_samples: int
    channels: int
    background: BackgroundConfig


class FieldHead(nn.Module):
    """Maps coarse features and lifted views to a field of twice the resolution per axis.

    The initial weights reproduce the views: channel 0 is dense on and behind observed surfaces, the
    next 3 have their colours. ``static_prior`` learns what is common to all scenes (table, robot's
    base). ``inputs``, ``lifted`` (per voxel) and ``extra``: numbers of input channels.
    """

    def __init__(
        self, inputs: int, lifted: int, extra: int, channels: int, coarse: tuple[int, int, int]
    ) -> None:
        super().__init__()
        self.static_prior = nn.Parameter(torch.zeros(8 * channels, *coarse))
        self.layer = nn.Conv3d(inputs + 8 * lifted + extra, 8 * channels, 1)
        weight, bias = torch.zeros(8, channels, self.layer.in_channels), torch.zeros(8, channels)
        bias[:, 0] = rays.DENSITY_SHIFT - DENSE_LOGIT / 2
        for sub_i in range(8):
            first = inputs + sub_i * lifted
            weight[sub_i, 0, first : first + 2] = torch.tensor([-DENSE_LOGIT, DENSE_LOGIT])
            weight[sub_i, 1:4, first + NUM_GEOMETRY : first + NUM_GEOMETRY + 3] = torch.eye(3)
        with torch.no_grad():
            # A little of the random initialization breaks the symmetry of the other channels.
            self.layer.weight.mul_(0.1).add_(weight.reshape(self.layer.weight.shape))
            self.layer.bias = nn.Parameter(bias.flatten())

    def forward(self, coarse_BCXYZ: Tensor, lifted_BCXYZ: Tensor) -> Tensor:
        """The field BCXYZ in float32."""
        # Gradients through the lift of all voxels are slow and improve the encoder little.
        inputs = torch.cat([coarse_BCXYZ, lifted_BCXYZ.detach()], dim=1)
        return unfold(self.layer(inputs).float() + PRIOR_GAIN * self.static_prior)


class BackgroundField(nn.Module):
    """Maps views and their features to the background field."""

    points: Tensor

    def __init__(self, cfg: BackgroundConfig, lifted: int, map_channels: int) -> None:
        super().__init__()
        self.cfg = cfg
        self.register_buffer("points", fold_order(centers(cfg.grid)), persistent=False)
        self.net = UNet(8 * lifted + 3, cfg.channels, cfg.blocks)
        self.map = FieldHead(cfg.channels[0], lifted, 3, map_channels, cfg.grid.halved().shape)

    def forward(self, views: Views, features_BVHWC: Tensor) -> Field:
        """The field of each of B scenes."""
        batch, shape = len(features_BVHWC), self.points.shape[:3]
        points = self.points.reshape(1, -1, 3).expand(batch, -1, -1)
        lifted = lift(self.cfg.lift, views, features_BVHWC, points).reshape(batch, *shape, -1)
        # World coordinates are inputs too: the robot's base is at the same place in every scene.
        position = self.points.mean(dim=3).expand(batch, *shape, 3).to(lifted.dtype)
        inputs = torch.cat([lifted, position], dim=-1).movedim(-1, 1)
        return Field(self.map(self.net(inputs), inputs), self.cfg.grid)


class ViewDecoder(nn.Module):
    """Composites scene map and background along rays; a 2D network refines the colours."""

    def __init__(self, cfg: DecoderConfig, map_channels: int) -> None:
        super().__init__()
        self.cfg = cfg
        width = cfg.channels
        self.first = _conv(map_channels - 1 + NUM_RAY_CHANNELS, width)
        self.middle = nn.ModuleList(_conv(width, width) for _ in range(3))
        self.last = _conv(width, 3 * cfg.stride_px**2)

    def forward(
        self, near: Field, far: Field, K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int]
    ) -> tuple[Tensor, Tensor]:
        """RGB BHW3, about [0, 1], and expected depth BHW (z, metres) of one camera for each scene.

        ``near``: the scene map. ``far``: the background. ``size``: (height, width), divisible by
        the stride. Depth is constant in each block of pixels.
        """
        stride = self.cfg.stride_px
        shape = (size[0] // stride, size[1] // stride)
        # bfloat16 has too few digits for ray directions and sums of optical thickness.
        with torch.autocast(K_B33.device.type, enabled=False):
            pixels = rays.camera_rays(K_B33, world_T_cam_B44, shape, stride)
            traced_BPC = self._trace(near, far, pixels)
            blocks = traced_BPC.transpose(1, 2).reshape(len(K_B33), -1, *shape)
        opacity, distance = blocks[:, -NUM_RAY_CHANNELS], blocks[:, 1 - NUM_RAY_CHANNELS]
        # The cosine to the optical axis turns ray length into z.
        cosine = (blocks[:, -3:] * world_T_cam_B44[:, :3, 2, None, None]).sum(1)
        depth = cosine * distance / opacity.clamp(min=MIN_OPACITY)
        depth = depth.repeat_interleave(stride, 1).repeat_interleave(stride, 2)
        return self._refine(blocks, size), depth

    def _refine(self, blocks_BCHW: Tensor, size: tuple[int, int]) -> Tensor:
        """RGB BHW3: the upsampled colours of the blocks (channels 0 to 2) plus a residual."""
        x = F.relu(self.first(blocks_BCHW.contiguous(memory_format=torch.channels_last)))
        for conv in self.middle:
            x = F.relu(x + conv(x))
        colors = F.interpolate(blocks_BCHW[:, :3], size=size, mode="bilinear", align_corners=False)
        return (colors + F.pixel_shuffle(self.last(x).float(), self.cfg.stride_px)).movedim(1, -1)

    def _trace(self, near: Field, far: Field, pixels: Rays) -> Tensor:
        """BPC of each ray: composited features, opacity, expected distance, origin, direction."""
        box = rays.ray_box_intersection(pixels, near.grid)
        first, last = rays.ray_box_intersection(pixels, far.grid)
        # A ray that misses the scene map is split in its middle, so all rays have equal samples.
        is_missed, middle = box[1] <= box[0], (first + last) / 2
        enter, leave = (torch.where(is_missed, middle, distance) for distance in box)
        num_samples, num_far = self.cfg.num_samples, self.cfg.background.num_samples
        before, after = (first, torch.maximum(first, enter)), (leave, torch.maximum(leave, last))
        parts = (
            rays.sample_along_rays(far, pixels, before, num_far),
            rays.sample_along_rays(near, pixels, (enter, leave), num_samples),
            rays.sample_along_rays(far, pixels, after, num_far),
        )
        samples = (torch.cat(values, dim=2) for values in zip(*parts, strict=True))
        features, distance, opacity = rays.alpha_composite(*samples)
        direction = pixels.direction_BP3
        origin = pixels.origin_B3[:, None].expand_as(direction)
        columns = [features, opacity[..., None], distance[..., None], origin, direction]
        return torch.cat(columns, dim=-1)


def _conv(inputs: int, outputs: int) -> nn.Conv2d:
    """3x3 convolution that keeps the size; replicated borders avoid dark edges."""
    return nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="replicate")
