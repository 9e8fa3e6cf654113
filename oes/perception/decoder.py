"""View prediction: the feature map seen from any camera, by compositing it along rays and decoding
the image in 2D.

Around and behind the scene map stands a coarser backdrop, lifted from the same views: most of the
arm is there.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.voxels import Grid, centers, fold_order, unfold
from oes.perception.blocks import UNet
from oes.perception.lift import NUM_GEOMETRY, LiftConfig, Views, lift
from oes.perception.rays import (
    CLEAR_LOGIT,
    Field,
    Rays,
    composite,
    march,
    ray_box_intersection,
    rays_of,
)

NUM_RAY_CHANNELS = 8
MIN_OPACITY = 1e-3
DENSE_LOGIT = 10.0
PRIOR_GAIN = (
    10.0  # one voxel learns alone what a shared weight learns from many: it must move faster
)


@params
class BackgroundConfig:
    """A coarse map of what surrounds the scene map, from a U-Net of its own on 2x2x2 blocks."""

    grid: Grid
    lift: LiftConfig
    channels: tuple[int, ...]
    blocks: tuple[int, ...]
    num_samples: int


@params
class DecoderConfig:
    """One ray per ``stride_px`` x ``stride_px`` pixels, ``num_samples`` samples where it crosses
    the scene map.

    Before and after it the backdrop is sampled, ``backdrop.num_samples`` times each.
    """

    stride_px: int
    num_samples: int
    channels: int
    backdrop: BackgroundConfig


class FieldHead(nn.Module):
    """Coarse features, with the lifted views they were made from, to a map of 2x2x2 times the
    resolution.

    It starts out as what the views show: dense on and behind seen surfaces (channel 0), in their
    colours (the next 3). ``memory`` is what every scene of the lab has, seen or not: the table, the
    pedestal.
    """

    def __init__(
        self, inputs: int, lifted: int, rest: int, channels: int, coarse: tuple[int, int, int]
    ) -> None:
        super().__init__()
        self.memory = nn.Parameter(torch.zeros(8 * channels, *coarse))
        self.layer = nn.Conv3d(inputs + 8 * lifted + rest, 8 * channels, 1)
        weight, bias = torch.zeros(8, channels, self.layer.in_channels), torch.zeros(8, channels)
        bias[:, 0] = CLEAR_LOGIT - DENSE_LOGIT / 2
        for sub_i in range(8):
            first = inputs + sub_i * lifted
            weight[sub_i, 0, first : first + 2] = torch.tensor([-DENSE_LOGIT, DENSE_LOGIT])
            weight[sub_i, 1:4, first + NUM_GEOMETRY : first + NUM_GEOMETRY + 3] = torch.eye(3)
        with torch.no_grad():
            self.layer.weight.mul_(0.1).add_(weight.reshape(self.layer.weight.shape))
            self.layer.bias = nn.Parameter(bias.flatten())

    def forward(self, coarse_BCXYZ: Tensor, lifted_BCXYZ: Tensor) -> Tensor:
        """The map BCXYZ in float32. No gradient runs into ``lifted_BCXYZ``: it would cost more than
        it teaches.
        """
        return unfold(
            self.layer(torch.cat([coarse_BCXYZ, lifted_BCXYZ.detach()], dim=1)).float()
            + PRIOR_GAIN * self.memory
        )


class BackgroundField(nn.Module):
    """Views and their features to the backdrop's field."""

    points: Tensor

    def __init__(self, cfg: BackgroundConfig, lifted: int, map_channels: int) -> None:
        super().__init__()
        self.cfg = cfg
        self.register_buffer("points", fold_order(centers(cfg.grid)), persistent=False)
        self.net = UNet(8 * lifted + 3, cfg.channels, cfg.blocks)
        self.map = FieldHead(cfg.channels[0], lifted, 3, map_channels, cfg.grid.halved().shape)

    def forward(self, views: Views, features_BVHWC: Tensor) -> Field:
        """Where a thing is in the world is an input too: the robot's base never moves."""
        batch, side = len(features_BVHWC), self.points.shape[:3]
        points = self.points.reshape(1, -1, 3).expand(batch, -1, -1)
        lifted = lift(self.cfg.lift, views, features_BVHWC, points).reshape(batch, *side, -1)
        place = self.points.mean(dim=3).expand(batch, *side, 3).to(lifted.dtype)
        inputs = torch.cat([lifted, place], dim=-1).movedim(-1, 1)
        return Field(self.map(self.net(inputs), inputs), self.cfg.grid)


class ViewDecoder(nn.Module):
    """Composites scene map and backdrop along each ray; a 2D net refines the colours so found
    (features 0 to 2).
    """

    def __init__(self, cfg: DecoderConfig, map_channels: int) -> None:
        super().__init__()
        self.cfg = cfg
        width = cfg.channels
        self.first = _conv(map_channels - 1 + NUM_RAY_CHANNELS, width)
        self.middle = nn.ModuleList(_conv(width, width) for _ in range(3))
        self.last = _conv(width, 3 * cfg.stride_px**2)

    def forward(
        self,
        near: Field,
        backdrop: Field,
        K_B33: Tensor,
        world_T_cam_B44: Tensor,
        size: tuple[int, int],
    ) -> Tensor:
        """RGB BHW3, about [0, 1], as the cameras see it; ``size`` is (height, width), divisible by
        the stride.
        """
        return self._refined(self._blocks(near, backdrop, K_B33, world_T_cam_B44, size), size)

    def rgbd(
        self,
        near: Field,
        backdrop: Field,
        K_B33: Tensor,
        world_T_cam_B44: Tensor,
        size: tuple[int, int],
    ) -> tuple[Tensor, Tensor]:
        """As ``forward``, and the depth BHW: z in metres of what is seen on average, one for each
        block of pixels.
        """
        blocks = self._blocks(near, backdrop, K_B33, world_T_cam_B44, size)
        opacity, distance = blocks[:, -NUM_RAY_CHANNELS], blocks[:, 1 - NUM_RAY_CHANNELS]
        forward = (blocks[:, -3:] * world_T_cam_B44[:, :3, 2, None, None]).sum(1)
        depth = forward * distance / opacity.clamp(min=MIN_OPACITY)
        stride = self.cfg.stride_px
        return self._refined(blocks, size), depth.repeat_interleave(stride, 1).repeat_interleave(
            stride, 2
        )

    def _blocks(
        self,
        near: Field,
        backdrop: Field,
        K_B33: Tensor,
        world_T_cam_B44: Tensor,
        size: tuple[int, int],
    ) -> Tensor:
        """What ``_seen`` finds for every block of pixels, as images BCHW."""
        height, width = size[0] // self.cfg.stride_px, size[1] // self.cfg.stride_px
        with torch.autocast(
            K_B33.device.type, enabled=False
        ):  # bfloat16 has too few digits for rays
            rays = rays_of(K_B33, world_T_cam_B44, (height, width), self.cfg.stride_px)
            return (
                self._seen(near, backdrop, rays)
                .transpose(1, 2)
                .reshape(len(K_B33), -1, height, width)
            )

    def _refined(self, blocks_BCHW: Tensor, size: tuple[int, int]) -> Tensor:
        """RGB BHW3 from the blocks: their colours, enlarged, and what the 2D net adds."""
        x = F.relu(self.first(blocks_BCHW.contiguous(memory_format=torch.channels_last)))
        for conv in self.middle:
            x = F.relu(x + conv(x))
        colors = F.interpolate(blocks_BCHW[:, :3], size=size, mode="bilinear", align_corners=False)
        return (colors + F.pixel_shuffle(self.last(x).float(), self.cfg.stride_px)).movedim(1, -1)

    def _seen(self, near: Field, backdrop: Field, rays: Rays) -> Tensor:
        """BPC: composited features, opacity, expected distance, origin and direction of each
        ray.
        """
        enter, leave = ray_box_intersection(rays, near.grid)
        first, last = ray_box_intersection(rays, backdrop.grid)
        is_missed = leave <= enter
        middle = (first + last) / 2
        enter, leave = torch.where(is_missed, middle, enter), torch.where(is_missed, middle, leave)
        parts = (
            march(
                backdrop, rays, (first, torch.maximum(first, enter)), self.cfg.backdrop.num_samples
            ),
            march(near, rays, (enter, leave), self.cfg.num_samples),
            march(
                backdrop, rays, (leave, torch.maximum(leave, last)), self.cfg.backdrop.num_samples
            ),
        )
        features, distance, opacity = composite(
            *(torch.cat(values, dim=2) for values in zip(*parts, strict=True))
        )
        origin = rays.origin_B3[:, None].expand_as(rays.direction_BP3)
        return torch.cat(
            [features, opacity[..., None], distance[..., None], origin, rays.direction_BP3], dim=-1
        )


def _conv(inputs: int, outputs: int) -> nn.Conv2d:
    """3x3 convolution that keeps the size and continues the image past its border."""
    return nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="replicate")
