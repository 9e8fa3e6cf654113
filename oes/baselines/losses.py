"""What the two baselines are trained for, on batches of clips."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.baselines.clips import Clips
from oes.baselines.planet import LatentState, PlaNet, distance_to_goals
from oes.baselines.visual_foresight import VisualForesight
from oes.config import params

SCALES = 3  # resolutions at which pictures are compared
CHANGED = 0.06  # of 0 to 1: a pixel that differs by so much shows something
Loss = Callable[[nn.Module, Clips], dict[str, Tensor]]


@params
class Latent:
    """What PlaNet's loss is made of besides its weights: free nats, how much more a pixel counts
    that differs from the mean picture, and how far from the objects goals are drawn (half
    pictures).
    """

    free_nats: float
    changed: float
    goal: float


def foresight_loss(changed: float) -> Loss:
    """Single steps: the next picture from the one before it, at several resolutions (L1).

    A pixel that changes counts ``1 + changed`` times.
    """

    def loss(net: nn.Module, clips: Clips) -> dict[str, Tensor]:
        assert isinstance(net, VisualForesight)
        steps = clips.frame_BI3HW.shape[1] - 1
        now, after = clips.frame_BI3HW[:, :-1].flatten(0, 1), clips.frame_BI3HW[:, 1:].flatten(0, 1)
        first = clips.frame_BI3HW[:, :1].expand(-1, steps, -1, -1, -1).flatten(0, 1)
        tip, action = clips.tip_BI2[:, :-1].flatten(0, 1), clips.tip_BI2.diff(dim=1).flatten(0, 1)
        made = net(now, first, tip, action)(now, first)
        weight = 1 + changed * ((after - now).abs().amax(1, keepdim=True) > CHANGED)
        total = made.new_zeros(())
        for scale in range(SCALES):
            if scale:
                made, after, weight = (F.avg_pool2d(x, 2) for x in (made, after, weight))
            total = total + ((made - after).abs() * weight).mean()
        return {"picture": total}

    return loss


def planet_loss(cfg: Latent, mean_3HW: Tensor) -> Loss:
    """Whole clips: pictures and rewards of the states seen, and how well the prior foretells
    them.
    """

    def loss(net: nn.Module, clips: Clips) -> dict[str, Tensor]:
        assert isinstance(net, PlaNet)
        batch, states = clips.frame_BI3HW.shape[:2]
        objects, goal_BG3 = draw_goals(clips, net.cfg.goals, cfg.goal)
        seen = net.encode(clips.frame_BI3HW.flatten(0, 1)).reshape(batch, states, -1)
        action_BIA = torch.cat([clips.tip_BI2[:, :-1], clips.tip_BI2.diff(dim=1)], -1)
        action_BIA = F.pad(action_BIA, (0, 0, 1, 0))
        state = net.begin(batch, seen)
        features, divergences = [], []
        for i in range(states):
            recurrent, prior = net.imagine(state, action_BIA[:, i])
            posterior = net.look(recurrent, seen[:, i], goal_BG3)
            state = LatentState(recurrent, posterior.sample())
            features.append(state.features())
            divergences.append(posterior.kl(prior).clamp(min=cfg.free_nats))
        features_BIC = torch.stack(features, 1)
        frame = clips.frame_BI3HW.flatten(0, 1)
        weight = 1 + cfg.changed * ((frame - mean_3HW).abs().amax(1, keepdim=True) > CHANGED)
        error = ((net.decode(features_BIC.flatten(0, 1)) - frame) ** 2 * weight).mean()
        reward_BI = net.rewards(features_BIC, goal_BG3[:, None].expand(-1, states, -1, -1))
        distance_BI = torch.stack(
            [distance_to_goals(objects[:, i], goal_BG3) for i in range(states)], 1
        )
        return {
            "image": error,
            "reward": ((reward_BI + distance_BI) ** 2).mean(),
            "kl": torch.stack(divergences[1:]).mean(),
        }

    return loss


def draw_goals(clips: Clips, goals: int, reach: float) -> tuple[Tensor, Tensor]:
    """Objects BIG2 from left to right as first seen, and a random goal near the first place of
    each: BG3.
    """
    place = torch.where(
        clips.valid_BN[:, None, :, None], clips.object_BIN2, torch.full_like(clips.object_BIN2, 9.0)
    )
    order = place[:, 0, :, 0].argsort(-1)[:, :goals]
    objects = place.gather(2, order[:, None, :, None].expand(-1, place.shape[1], -1, 2))
    valid = clips.valid_BN.gather(1, order)
    if valid.shape[1] < goals:
        objects, valid = (
            F.pad(objects, (0, 0, 0, goals - valid.shape[1])),
            F.pad(valid, (0, goals - valid.shape[1])),
        )
    goal = (objects[:, 0] + reach * (2 * torch.rand_like(objects[:, 0]) - 1)).clamp(-0.8, 0.8)
    return objects, torch.cat([goal * valid[..., None], valid[..., None].float()], -1)
