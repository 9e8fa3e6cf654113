"""What a baseline has learned, on episodes it never saw: pictures, places and rewards forecast
against what came.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.baselines.clips import Clips
from oes.baselines.losses import draw_goals
from oes.baselines.overhead_camera import OverheadView
from oes.baselines.planet import PlaNet, distance_to_goals, unroll_latent
from oes.baselines.visual_foresight import VisualForesight, expected_pixel, unroll_pixels
from oes.metrics.image_metrics import image_quality

EVALUATED_STEPS = (1, 3, 5)
NUM_SHOWN = 4
ForecastRow = dict[str, float | int]


@torch.no_grad()
def forecast_rows(
    net: VisualForesight | PlaNet, clips: Clips, view: OverheadView
) -> tuple[list[ForecastRow], NDArray[np.uint8]]:
    """A row per clip and horizon, and the first forecasts as a picture: above what came, below what
    was forecast.

    ``psnr_db`` and ``ssim`` of the forecast picture, ``still_...`` of the first picture in its
    place. Visual Foresight: ``error_mm`` of where designated pixels are expected, ``still_mm`` if
    they stay. PlaNet: ``error_mm`` of the distance to a random goal that its reward tells,
    ``still_mm`` of the distance at the start.
    """
    rows: list[ForecastRow] = []
    shown = []
    for i in range(len(clips)):
        clip = clips.at(torch.tensor([i]))
        made, error_mm, still_mm = (
            _pixels(net, clip, view)
            if isinstance(net, VisualForesight)
            else _rewards(net, clip, view, i)
        )
        true = clip.frame_BI3HW[0]
        for T in EVALUATED_STEPS:
            still = {
                f"still_{name}": value for name, value in image_quality(true[0], true[T]).items()
            }
            figures = image_quality(made[T - 1], true[T]) | still
            rows.append(
                {
                    "clip": i,
                    "T": T,
                    **figures,
                    "error_mm": error_mm[T - 1],
                    "still_mm": still_mm[T - 1],
                }
            )
        if i < NUM_SHOWN:
            shown.append(torch.cat([torch.cat([*true], -1), torch.cat([true[0], *made], -1)], -2))
    picture = (torch.cat(shown, -2).clamp(0, 1) * 255).round().byte().permute(1, 2, 0).numpy()
    return rows, picture


def _pixels(
    net: VisualForesight, clip: Clips, view: OverheadView
) -> tuple[Tensor, list[float], list[float]]:
    place_IN2 = clip.object_BIN2[0][:, clip.valid_BN[0]]
    start, actions = clip.frame_BI3HW[0, 0], clip.tip_BI2.diff(dim=1)
    made, maps = unroll_pixels(net, start, place_IN2[0], clip.tip_BI2[:, 0], actions)
    found_TN2 = torch.stack([expected_pixel(each)[0] for each in maps.unbind(1)])
    still_TN2 = place_IN2[:1].expand_as(found_TN2)
    return made[0], _mm(found_TN2, place_IN2[1:], view), _mm(still_TN2, place_IN2[1:], view)


def _mm(found_TN2: Tensor, true_TN2: Tensor, view: OverheadView) -> list[float]:
    return [float(x) for x in (found_TN2 - true_TN2).norm(dim=-1).mean(-1) * view.half_m * 1e3]


def _rewards(
    net: PlaNet, clip: Clips, view: OverheadView, seed: int
) -> tuple[Tensor, list[float], list[float]]:
    torch.manual_seed(seed)
    objects, goal_1G3 = draw_goals(clip, net.cfg.goals, 1.0)
    actions = clip.tip_BI2.diff(dim=1)
    features, rewards = unroll_latent(
        net, clip.frame_BI3HW[0, 0], goal_1G3[0], clip.tip_BI2[:, 0], actions
    )
    true_I = torch.stack([distance_to_goals(place, goal_1G3)[0] for place in objects.unbind(1)])
    to_mm = view.half_m * 1e3
    error_T, still_T = (
        (rewards[0] + true_I[1:]).abs() * to_mm,
        (true_I[0] - true_I[1:]).abs() * to_mm,
    )
    return net.decode(features[0]), error_T.tolist(), still_T.tolist()
