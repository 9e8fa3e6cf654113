"""Training losses of the two baselines on batches of clips."""

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.distributions import kl_divergence

from oes.baselines.clips import Clips
from oes.baselines.planet import LatentState, PlaNet, distance_to_goals
from oes.baselines.visual_foresight import VisualForesight
from oes.config import params

NUM_SCALES = 3  # resolutions at which images are compared
MIN_CHANGE = 0.06  # smallest difference (0 to 1) of a pixel that counts as changed
MAX_GOAL = 0.8  # goals stay this close to the image's centre along each axis
BEYOND = 9.0  # coordinate of absent objects, so that they are sorted last
ClipsLoss = Callable[[nn.Module, Clips], dict[str, Tensor]]


@params
class PlanetLossConfig:
    """``free_nats``: of the KL. ``goal_range``: largest offset of a goal per axis (normalised).

    A pixel that differs from the mean image counts ``1 + changed_pixel_weight`` times.
    """

    free_nats: float
    changed_pixel_weight: float
    goal_range: float


def foresight_loss(changed_pixel_weight: float) -> ClipsLoss:
    """Multi-scale L1 error of the next image, on single steps.

    A pixel that changes counts ``1 + changed_pixel_weight`` times.
    """

    def loss(net: nn.Module, clips: Clips) -> dict[str, Tensor]:
        assert isinstance(net, VisualForesight)
        frame, num_steps = clips.frame_BI3HW, clips.frame_BI3HW.shape[1] - 1
        current, target = frame[:, :-1].flatten(0, 1), frame[:, 1:].flatten(0, 1)
        first = frame[:, :1].expand(-1, num_steps, -1, -1, -1).flatten(0, 1)
        tip, action = clips.tip_BI2[:, :-1].flatten(0, 1), clips.tip_BI2.diff(dim=1).flatten(0, 1)
        predicted = net(current, first, tip, action)(current, first)
        weight = _pixel_weight(target - current, changed_pixel_weight)
        # Coarse scales reward flow in the right direction before it hits the right pixel.
        total = predicted.new_zeros(())
        for scale in range(NUM_SCALES):
            if scale:
                images = (F.avg_pool2d(x, 2) for x in (predicted, target, weight))
                predicted, target, weight = images
            total = total + ((predicted - target).abs() * weight).mean()
        return {"image": total}

    return loss


def planet_loss(cfg: PlanetLossConfig, mean_3HW: Tensor) -> ClipsLoss:
    """Image and reward errors of whole clips, and the KL divergence of posterior and prior."""

    def loss(net: nn.Module, clips: Clips) -> dict[str, Tensor]:
        assert isinstance(net, PlaNet)
        batch, num_states = clips.frame_BI3HW.shape[:2]
        object_BIG2, goal_BG3 = draw_goals(clips, net.cfg.max_goals, cfg.goal_range)
        frame = clips.frame_BI3HW.flatten(0, 1)
        embedding_BIC = net.encode(frame).reshape(batch, num_states, -1)
        action_BI4 = torch.cat([clips.tip_BI2[:, :-1], clips.tip_BI2.diff(dim=1)], -1)
        action_BI4 = F.pad(action_BI4, (0, 0, 1, 0))  # no action leads to the first image
        state = net.initial(batch, embedding_BIC)
        features, divergences = [], []
        for i in range(num_states):
            recurrent, prior = net.prior(state, action_BI4[:, i])
            posterior = net.posterior(recurrent, embedding_BIC[:, i], goal_BG3)
            state = LatentState(recurrent, posterior.rsample())
            features.append(state.features())
            divergence_B = kl_divergence(posterior, prior).sum(-1)
            # Free nats: no gradient pushes the posterior onto the prior below this level.
            divergences.append(divergence_B.clamp(min=cfg.free_nats))
        features_BIC = torch.stack(features, 1)
        weight = _pixel_weight(frame - mean_3HW, cfg.changed_pixel_weight)
        error = ((net.decode(features_BIC.flatten(0, 1)) - frame) ** 2 * weight).mean()
        reward_BI = net.rewards(features_BIC, goal_BG3[:, None].expand(-1, num_states, -1, -1))
        distances = [distance_to_goals(objects, goal_BG3) for objects in object_BIG2.unbind(1)]
        return {
            "image": error,
            "reward": ((reward_BI + torch.stack(distances, 1)) ** 2).mean(),
            # Without the first state: nothing could predict it.
            "kl": torch.stack(divergences[1:]).mean(),
        }

    return loss


def _pixel_weight(change_B3HW: Tensor, extra: float) -> Tensor:
    # Objects cover about 1% of the image; unweighted, the best forecast is the background.
    return 1 + extra * (change_B3HW.abs().amax(1, keepdim=True) > MIN_CHANGE)


def draw_goals(clips: Clips, max_goals: int, goal_range: float) -> tuple[Tensor, Tensor]:
    """Objects BIG2 from left to right in the first image, and a random goal near each: BG3."""
    exists = clips.valid_BN[:, None, :, None]
    object_BIN2 = torch.where(exists, clips.object_BIN2, torch.full_like(clips.object_BIN2, BEYOND))
    order = object_BIN2[:, 0, :, 0].argsort(-1)[:, :max_goals]
    index = order[:, None, :, None].expand(-1, object_BIN2.shape[1], -1, 2)
    objects, valid = object_BIN2.gather(2, index), clips.valid_BN.gather(1, order)
    missing = max_goals - valid.shape[1]
    objects, valid = F.pad(objects, (0, 0, 0, missing)), F.pad(valid, (0, missing))
    start = objects[:, 0]
    goal = (start + goal_range * (2 * torch.rand_like(start) - 1)).clamp(-MAX_GOAL, MAX_GOAL)
    return objects, torch.cat([goal * valid[..., None], valid[..., None].float()], -1)
