"""Visual Foresight at small size: the next picture is the last one with its pixels moved (Ebert et
al. 2018; C.2).

A convolutional network sees the picture now, the first picture, the push and where the rod is
before and after it, and gives several fields of flow and masks; the next picture is the masked sum
of the pictures moved by each flow, of the picture now and of the first. What holds for colours
holds for the chance that a designated pixel is somewhere. Deviations from the original, for two
cores: no recurrence (as in the public code's ablation), trained on single steps, the rod's places
as maps.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params

BLOB = 0.06  # width of the rod's map, in units of half the picture
REACH = 0.3  # how far a flow reaches, in units of half the picture: a push is 0.1 to 0.19
ROD = 4  # channels that tell of the push: two maps and its two components


@params
class ForesightConfig:
    """Output channels at each resolution, halved from one to the next, and how many flows there
    are.
    """

    channels: tuple[int, ...]
    flows: int


@dataclass(frozen=True)
class FlowWarp:
    """How one step moves pixels: each of F flows (BFHW2, in half pictures, from where a pixel's
    content comes) and the weights of the F moved pictures, of the picture now and of the first
    (BMHW, M = F + 2, summing to 1).
    """

    flow_BFHW2: Tensor
    mask_BMHW: Tensor

    def __call__(self, now_BCHW: Tensor, first_BCHW: Tensor) -> Tensor:
        """The next picture, or the next map."""
        batch, channels, height, width = now_BCHW.shape
        flows = self.flow_BFHW2.shape[1]
        grid = pixel_grid(height, width, now_BCHW) + self.flow_BFHW2
        sources = (
            now_BCHW[:, None].expand(-1, flows, -1, -1, -1).reshape(-1, channels, height, width)
        )
        moved = F.grid_sample(
            sources, grid.reshape(-1, height, width, 2), padding_mode="border", align_corners=False
        ).reshape(batch, flows, channels, height, width)
        candidates = torch.cat([moved, now_BCHW[:, None], first_BCHW[:, None]], 1)
        return (candidates * self.mask_BMHW[:, :, None]).sum(1)


class VisualForesight(nn.Module):
    """One step of video prediction."""

    def __init__(self, cfg: ForesightConfig) -> None:
        super().__init__()
        self.cfg = cfg
        widths = cfg.channels
        inputs = (6, *widths[:-1])
        self.down = nn.ModuleList(_conv(i + ROD, o) for i, o in zip(inputs, widths, strict=True))
        pairs = list(zip(widths[:0:-1], widths[-2::-1], strict=True))
        self.up = nn.ModuleList(_conv(i + o + ROD, o) for i, o in pairs)
        self.out = nn.Conv2d(widths[0], 3 * cfg.flows + 2, 3, padding=1)

    def forward(
        self, now_B3HW: Tensor, first_B3HW: Tensor, tip_B2: Tensor, action_B2: Tensor
    ) -> FlowWarp:
        """How pixels move while the rod goes from ``tip_B2`` by ``action_B2`` (coordinates of
        ``Overhead``).
        """
        x = torch.cat([now_B3HW, first_B3HW], 1) - 0.5
        kept: list[Tensor] = []
        for i, layer in enumerate(self.down):
            x = layer(
                torch.cat(
                    [x if i == 0 else F.avg_pool2d(x, 2), _push_maps(tip_B2, action_B2, x, i)], 1
                )
            )
            kept.append(x)
        for i, layer in enumerate(self.up):
            x = F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
            skip = kept[-2 - i]
            x = layer(torch.cat([x, skip, _push_maps(tip_B2, action_B2, skip, 0)], 1))
        flows = self.cfg.flows
        flow, logits = self.out(x).float().split((2 * flows, flows + 2), 1)
        flow_BFHW2 = REACH * flow.unflatten(1, (flows, 2)).tanh().permute(0, 1, 3, 4, 2)
        return FlowWarp(flow_BFHW2, logits.softmax(1))


def _push_maps(tip_B2: Tensor, action_B2: Tensor, like_BCHW: Tensor, halvings: int) -> Tensor:
    """Where the rod is and will be, and the push everywhere: B4HW, at the resolution of ``like``
    (halved if asked).
    """
    scale = 2 if halvings else 1
    height, width = like_BCHW.shape[-2] // scale, like_BCHW.shape[-1] // scale
    grid = pixel_grid(height, width, like_BCHW)
    maps = [
        torch.exp(-((grid - place[:, None, None]) ** 2).sum(-1) / (2 * BLOB**2))[:, None]
        for place in (tip_B2, tip_B2 + action_B2)
    ]
    push = (action_B2 / REACH)[:, :, None, None].expand(-1, -1, height, width)
    return torch.cat([*maps, push], 1)


def pixel_grid(height: int, width: int, like: Tensor) -> Tensor:
    """Middles of pixels, HW2, from -1 to 1, x first."""
    lines = [(torch.arange(n, device=like.device) + 0.5) * 2 / n - 1 for n in (height, width)]
    y_HW, x_HW = torch.meshgrid(*lines, indexing="ij")
    return torch.stack([x_HW, y_HW], -1)


def pixel_distribution(place_BN2: Tensor, height: int, width: int) -> Tensor:
    """A map of one object each, BNHW: all of it at the pixels around a place (bilinear), summing to
    1.
    """
    grid = pixel_grid(height, width, place_BN2)
    pitch = torch.tensor([2 / width, 2 / height], device=place_BN2.device)
    near = (1 - (grid - place_BN2[:, :, None, None]).abs() / pitch).clamp(min=0).prod(-1)
    return near / near.sum((-2, -1), keepdim=True).clamp(min=1e-6)


def expected_pixel(map_BNHW: Tensor) -> Tensor:
    """The mean place BN2 of a map."""
    height, width = map_BNHW.shape[-2:]
    grid = pixel_grid(height, width, map_BNHW)
    return torch.einsum("bnhw,hwc->bnc", map_BNHW, grid)


def _conv(inputs: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, 3, padding=1),
        nn.GroupNorm(4, outputs),
        nn.LeakyReLU(0.2),
        nn.Conv2d(outputs, outputs, 3, padding=1),
        nn.LeakyReLU(0.2),
    )


@torch.no_grad()
def unroll_pixels(
    net: VisualForesight, frame_3HW: Tensor, place_N2: Tensor, tip_S2: Tensor, actions_SH2: Tensor
) -> tuple[Tensor, Tensor]:
    """Pictures SH3HW and maps SHNHW of designated pixels that start at ``place_N2``, under S
    plans.
    """
    samples = len(tip_S2)
    first = now = frame_3HW.expand(samples, -1, -1, -1)
    start = spread = pixel_distribution(place_N2[None], *frame_3HW.shape[-2:]).expand(
        samples, -1, -1, -1
    )
    frames, maps = [], []
    for action_S2 in actions_SH2.unbind(1):
        moves = net(now, first, tip_S2, action_S2)
        now, spread = moves(now, first), moves(spread, start)
        spread = spread / spread.sum((-2, -1), keepdim=True).clamp(min=1e-6)
        tip_S2 = tip_S2 + action_S2
        frames.append(now)
        maps.append(spread)
    return torch.stack(frames, 1), torch.stack(maps, 1)
