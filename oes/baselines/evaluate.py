"""Forecast errors of a baseline on held-out clips: images, object positions and rewards."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.baselines.clips import Clips
from oes.baselines.losses import draw_goals
from oes.baselines.planet import PlaNet, distance_to_goals, unroll_latent
from oes.baselines.visual_foresight import VisualForesight, expected_pixel, unroll_pixels
from oes.metrics.image_metrics import image_quality

EVALUATED_STEPS = (1, 3, 5)
NUM_SHOWN = 4
GOAL_RANGE = 1.0  # of the random goals for PlaNet's reward (normalised image coordinates)
ForecastRow = dict[str, float | int]


@torch.no_grad()
def forecast_rows(
    net: VisualForesight | PlaNet, clips: Clips, half_m: float
) -> tuple[list[ForecastRow], NDArray[np.uint8]]:
    """A row per clip and horizon; the first forecasts as one image, each below the true clip.

    ``psnr_db`` and ``ssim`` compare the forecast image with the true one; ``still_...`` are those
    of the first image. ``error_mm`` (``still_mm`` without motion) is, for Visual Foresight, the
    error of the expected pixels of the objects; for PlaNet, the error of the distance to a random
    goal that the reward predicts. ``half_m`` is half the width of the image.
    """
    rows: list[ForecastRow] = []
    shown = []
    for clip_i in range(len(clips)):
        clip = clips.at(torch.tensor([clip_i]))
        if isinstance(net, VisualForesight):
            predicted, error_mm_T, still_mm_T = _pixel_errors(net, clip, half_m)
        else:
            predicted, error_mm_T, still_mm_T = _reward_errors(net, clip, half_m, clip_i)
        true = clip.frame_BI3HW[0]
        for T in EVALUATED_STEPS:
            still = image_quality(true[0], true[T])
            row: ForecastRow = {"clip": clip_i, "T": T}
            row |= image_quality(predicted[T - 1], true[T])
            row |= {f"still_{name}": value for name, value in still.items()}
            row |= {"error_mm": float(error_mm_T[T - 1]), "still_mm": float(still_mm_T[T - 1])}
            rows.append(row)
        if clip_i < NUM_SHOWN:
            shown += [torch.cat([*true], -1), torch.cat([true[0], *predicted], -1)]
    image_3HW = (torch.cat(shown, -2).clamp(0, 1) * 255).round().byte()
    return rows, image_3HW.permute(1, 2, 0).numpy()


def _pixel_errors(
    net: VisualForesight, clip: Clips, half_m: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Images T3HW, mean errors T of the objects' pixels and their displacements T, both in mm."""
    object_IN2 = clip.object_BIN2[0][:, clip.valid_BN[0]]
    start, actions = clip.frame_BI3HW[0, 0], clip.tip_BI2.diff(dim=1)
    predicted, maps = unroll_pixels(net, start, object_IN2[0], clip.tip_BI2[:, 0], actions)
    pixel_TN2 = torch.stack([expected_pixel(map_BNHW)[0] for map_BNHW in maps.unbind(1)])
    errors = (pixel_TN2 - object_IN2[1:], object_IN2[:1] - object_IN2[1:])
    error_mm_T, still_mm_T = (error.norm(dim=-1).mean(-1) * half_m * 1e3 for error in errors)
    return predicted[0], error_mm_T, still_mm_T


def _reward_errors(
    net: PlaNet, clip: Clips, half_m: float, seed: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Images T3HW, errors T of the predicted distance to the goals and its changes T, in mm."""
    torch.manual_seed(seed)  # draw_goals uses the global generator
    object_BIG2, goal_1G3 = draw_goals(clip, net.cfg.max_goals, GOAL_RANGE)
    start, actions = clip.frame_BI3HW[0, 0], clip.tip_BI2.diff(dim=1)
    features, rewards = unroll_latent(net, start, goal_1G3[0], clip.tip_BI2[:, 0], actions)
    distances = [distance_to_goals(objects, goal_1G3)[0] for objects in object_BIG2.unbind(1)]
    distance_I = torch.stack(distances)
    errors = (rewards[0] + distance_I[1:], distance_I[0] - distance_I[1:])
    error_mm_T, still_mm_T = (error.abs() * (half_m * 1e3) for error in errors)
    return net.decode(features[0]), error_mm_T, still_mm_T
