"""Visual Foresight at small size: video prediction by warping pixels (Ebert et al. 2018; C.2).

From the current image, the first image and the push, a U-Net predicts flow fields and blending
masks. The next image is the masked sum of the current image warped by each flow, of the current
image and of the first image. Probability maps of designated pixels are warped alike. Deviations
from the original, to train on two cores: no recurrence (as in the ablation of the public code),
training on single steps, the rod's positions as input maps.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params

ROD_SIGMA = 0.06  # standard deviation of the rod's map (normalised image coordinates)
MAX_FLOW = 0.3  # largest flow per axis (the same): pushes are 0.1 to 0.19 long
PUSH_CHANNELS = 4  # maps of the rod before and after, and the two components of the push


@params
class ForesightConfig:
    """``channels``: output channels per resolution; each resolution is half the previous one."""

    channels: tuple[int, ...]
    num_flows: int


@dataclass(frozen=True)
class FlowWarp:
    """Pixel motion of one step.

    ``flow``: B x num_flows x H x W x 2, from a pixel to the source of its content (normalised image
    coordinates). ``mask``: B x (num_flows + 2) x H x W; weights of the warped images, the current
    and the first image, summing to 1.
    """

    flow: Tensor
    mask: Tensor

    def __call__(self, current_BCHW: Tensor, first_BCHW: Tensor) -> Tensor:
        """The next image or probability map, BCHW."""
        batch, channels, height, width = current_BCHW.shape
        num_flows = self.flow.shape[1]
        grid = pixel_grid(height, width, current_BCHW) + self.flow
        sources = current_BCHW[:, None].expand(-1, num_flows, -1, -1, -1)
        warped = F.grid_sample(
            sources.reshape(-1, channels, height, width),
            grid.reshape(-1, height, width, 2),
            padding_mode="border",
            align_corners=False,
        ).reshape(batch, num_flows, channels, height, width)
        candidates = torch.cat([warped, current_BCHW[:, None], first_BCHW[:, None]], 1)
        return (candidates * self.mask[:, :, None]).sum(1)


class VisualForesight(nn.Module):
    """One step of video prediction."""

    def __init__(self, cfg: ForesightConfig) -> None:
        super().__init__()
        self.cfg = cfg
        widths = cfg.channels
        inputs = (6, *widths[:-1])  # current and first image
        pairs = zip(inputs, widths, strict=True)
        self.down = nn.ModuleList(_conv(i + PUSH_CHANNELS, o) for i, o in pairs)
        pairs = zip(widths[:0:-1], widths[-2::-1], strict=True)
        self.up = nn.ModuleList(_conv(i + o + PUSH_CHANNELS, o) for i, o in pairs)
        self.out = nn.Conv2d(widths[0], 3 * cfg.num_flows + 2, 3, padding=1)

    def forward(
        self, current_B3HW: Tensor, first_B3HW: Tensor, tip_B2: Tensor, action_B2: Tensor
    ) -> FlowWarp:
        """Pixel motion while the rod moves from ``tip_B2`` by ``action_B2`` (normalised)."""
        x = torch.cat([current_B3HW, first_B3HW], 1) - 0.5
        skips: list[Tensor] = []
        for i, layer in enumerate(self.down):
            x = x if i == 0 else F.avg_pool2d(x, 2)
            # The push enters at every resolution, since all of them predict its motion.
            x = layer(torch.cat([x, _push_maps(tip_B2, action_B2, x)], 1))
            skips.append(x)
        for i, layer in enumerate(self.up):
            x = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            skip = skips[-2 - i]
            x = layer(torch.cat([x, skip, _push_maps(tip_B2, action_B2, skip)], 1))
        num_flows = self.cfg.num_flows
        # float32 also under autocast: bfloat16 would round the flow to several pixels.
        flow, logits = self.out(x).float().split((2 * num_flows, num_flows + 2), 1)
        flow = MAX_FLOW * flow.unflatten(1, (num_flows, 2)).tanh().permute(0, 1, 3, 4, 2)
        return FlowWarp(flow, logits.softmax(1))


def _push_maps(tip_B2: Tensor, action_B2: Tensor, like_BCHW: Tensor) -> Tensor:
    """Gaussians at the rod's position before and after, and the push everywhere: B4HW."""
    height, width = like_BCHW.shape[-2:]
    grid = pixel_grid(height, width, like_BCHW)
    maps = [
        torch.exp(-((grid - tip[:, None, None]) ** 2).sum(-1) / (2 * ROD_SIGMA**2))[:, None]
        for tip in (tip_B2, tip_B2 + action_B2)
    ]
    push = (action_B2 / MAX_FLOW)[:, :, None, None].expand(-1, -1, height, width)
    return torch.cat([*maps, push], 1)


def pixel_grid(height: int, width: int, like: Tensor) -> Tensor:
    """Normalised coordinates of pixel centres, HW2, x first."""
    axes = [(torch.arange(n, device=like.device) + 0.5) * 2 / n - 1 for n in (height, width)]
    y_HW, x_HW = torch.meshgrid(*axes, indexing="ij")
    return torch.stack([x_HW, y_HW], -1)


def pixel_distribution(pixel_BN2: Tensor, height: int, width: int) -> Tensor:
    """Probability maps BNHW: all mass on the pixels around a position, by bilinear weights."""
    grid = pixel_grid(height, width, pixel_BN2)
    pitch = torch.tensor([2 / width, 2 / height], device=pixel_BN2.device)
    map_BNHW = (1 - (grid - pixel_BN2[:, :, None, None]).abs() / pitch).clamp(min=0).prod(-1)
    return _normalised(map_BNHW)


def expected_pixel(map_BNHW: Tensor) -> Tensor:
    """Mean position BN2 of probability maps."""
    height, width = map_BNHW.shape[-2:]
    grid = pixel_grid(height, width, map_BNHW)
    return torch.einsum("bnhw,hwc->bnc", map_BNHW, grid)


@torch.no_grad()
def unroll_pixels(
    net: VisualForesight, frame_3HW: Tensor, pixel_N2: Tensor, tip_S2: Tensor, actions_ST2: Tensor
) -> tuple[Tensor, Tensor]:
    """Images ST3HW, and probability maps STNHW of pixels that start at ``pixel_N2``."""
    num_plans = len(tip_S2)
    first = current = frame_3HW.expand(num_plans, -1, -1, -1)
    start = pixel_distribution(pixel_N2[None], *frame_3HW.shape[-2:])
    first_map = current_map = start.expand(num_plans, -1, -1, -1)
    frames, maps = [], []
    for action_S2 in actions_ST2.unbind(1):
        warp = net(current, first, tip_S2, action_S2)
        current = warp(current, first)
        # Mass that flows out of the image would otherwise count as reaching no goal at no cost.
        current_map = _normalised(warp(current_map, first_map))
        tip_S2 = tip_S2 + action_S2
        frames.append(current)
        maps.append(current_map)
    return torch.stack(frames, 1), torch.stack(maps, 1)


def _normalised(map_BNHW: Tensor) -> Tensor:
    return map_BNHW / map_BNHW.sum((-2, -1), keepdim=True).clamp(min=1e-6)


def _conv(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.GroupNorm(4, outputs),
        nn.LeakyReLU(0.2),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.LeakyReLU(0.2),
    )
