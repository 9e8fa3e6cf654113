"""PlaNet at small size: a recurrent state-space model of images and rewards (Hafner et al. 2019).

As in appendix C.2, the goals are inputs of the first fully connected layer after the image encoder,
and the reward is minus the distance to the goals. Deviations from the original: that layer; goals
are inputs of the reward head; the action contains the rod's start, since pushes start anywhere;
pixels that differ from the mean image have a larger weight, since objects cover 1% of the image.
"""

import itertools
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn
from torch.distributions import Normal

from oes.config import params

ACTION_DIM = 4  # position and displacement of the rod
MIN_STD = 0.1


@params
class PlanetConfig:
    """``base_channels``: of the first convolution; each of the four doubles them.

    ``hidden_dim``: width of every fully connected layer.
    """

    base_channels: int
    recurrent_dim: int
    stochastic_dim: int
    hidden_dim: int
    max_goals: int


@dataclass(frozen=True)
class LatentState:
    """The deterministic and the stochastic part of a state."""

    recurrent_BC: Tensor
    stochastic_BC: Tensor

    def features(self) -> Tensor:
        """Input of the decoder and of the reward head, BC."""
        return torch.cat([self.recurrent_BC, self.stochastic_BC], -1)


class PlaNet(nn.Module):
    """Recurrent state-space model; a goal is x, y (normalised) and whether it exists (1 or 0)."""

    def __init__(self, cfg: PlanetConfig) -> None:
        super().__init__()
        self.cfg = cfg
        base, hidden, goals = cfg.base_channels, cfg.hidden_dim, 3 * cfg.max_goals
        stochastic, recurrent = cfg.stochastic_dim, cfg.recurrent_dim
        widths = (3, base, 2 * base, 4 * base, 8 * base)
        pairs = itertools.pairwise(widths)
        convs = [nn.Sequential(nn.Conv2d(i, o, 4, 2), nn.ReLU()) for i, o in pairs]
        self.encoder = nn.Sequential(*convs, nn.Flatten())
        self.embedding = nn.Linear(32 * base, hidden)
        self.gru_input = nn.Linear(stochastic + ACTION_DIM, hidden)
        self.gru = nn.GRUCell(hidden, recurrent)
        self.prior_head = _mlp(recurrent, hidden, 2 * stochastic)
        self.posterior_head = _mlp(recurrent + hidden + goals, hidden, 2 * stochastic)
        self.decoder_input = nn.Linear(recurrent + stochastic, 32 * base)
        # Kernels of 5, 5, 6 and 6 with stride 2 take 1 pixel to the 64 of the images.
        widths, sizes = (32 * base, 4 * base, 2 * base, base, 3), (5, 5, 6, 6)
        layers: list[nn.Module] = []
        for (i, o), size in zip(itertools.pairwise(widths), sizes, strict=True):
            layers += [nn.ConvTranspose2d(i, o, size, 2), nn.ReLU()]
        self.decoder = nn.Sequential(*layers[:-1])
        self.reward_head = _mlp(recurrent + stochastic + goals, hidden, 1)

    def encode(self, frame_B3HW: Tensor) -> Tensor:
        """Image embedding BC."""
        return F.relu(self.embedding(self.encoder(frame_B3HW - 0.5)))

    def initial(self, batch: int, like: Tensor) -> LatentState:
        """The zero state before the first image."""
        sizes = (self.cfg.recurrent_dim, self.cfg.stochastic_dim)
        return LatentState(*(like.new_zeros(batch, size) for size in sizes))

    def prior(self, state: LatentState, action_B4: Tensor) -> tuple[Tensor, Normal]:
        """The deterministic part after an action, and the prior of the stochastic part."""
        hidden = F.relu(self.gru_input(torch.cat([state.stochastic_BC, action_B4], -1)))
        recurrent_BC = self.gru(hidden, state.recurrent_BC)
        return recurrent_BC, _normal(self.prior_head(recurrent_BC))

    def posterior(self, recurrent_BC: Tensor, embedding_BC: Tensor, goal_BG3: Tensor) -> Normal:
        """Distribution of the stochastic part given an image."""
        inputs = torch.cat([recurrent_BC, embedding_BC, goal_BG3.flatten(1)], -1)
        return _normal(self.posterior_head(inputs))

    def decode(self, features_BC: Tensor) -> Tensor:
        """Reconstructed image B3HW, about 0 to 1."""
        image: Tensor = self.decoder(self.decoder_input(features_BC)[..., None, None])
        return image + 0.5

    def rewards(self, features_BC: Tensor, goal_BG3: Tensor) -> Tensor:
        """Minus the mean distance to the goals: B, or any other leading dimensions."""
        inputs = torch.cat([features_BC, goal_BG3.flatten(-2)], -1)
        reward: Tensor = self.reward_head(inputs)[..., 0]
        return reward


def distance_to_goals(object_BN2: Tensor, goal_BG3: Tensor) -> Tensor:
    """Mean distance of the objects to the goals that exist (N = G): B."""
    exists_BG = goal_BG3[..., 2]
    distance_BG = (object_BN2 - goal_BG3[..., :2]).norm(dim=-1) * exists_BG
    mean_B: Tensor = distance_BG.sum(-1) / exists_BG.sum(-1).clamp(min=1)
    return mean_B


@torch.no_grad()
def unroll_latent(
    net: PlaNet, frame_3HW: Tensor, goal_G3: Tensor, tip_S2: Tensor, actions_ST2: Tensor
) -> tuple[Tensor, Tensor]:
    """State features STC and rewards ST of S plans that start from one image."""
    num_plans = len(tip_S2)
    goal_SG3 = goal_G3.expand(num_plans, -1, -1)
    embedding = net.encode(frame_3HW[None]).expand(num_plans, -1)
    no_action = embedding.new_zeros(num_plans, ACTION_DIM)
    recurrent, _ = net.prior(net.initial(num_plans, embedding), no_action)
    # Means instead of samples: samples would only add noise to the comparison of plans.
    state = LatentState(recurrent, net.posterior(recurrent, embedding, goal_SG3).mean)
    features, rewards = [], []
    for action_S2 in actions_ST2.unbind(1):
        recurrent, prior = net.prior(state, torch.cat([tip_S2, action_S2], -1))
        state = LatentState(recurrent, prior.mean)
        features.append(state.features())
        rewards.append(net.rewards(features[-1], goal_SG3))
        tip_S2 = tip_S2 + action_S2
    return torch.stack(features, 1), torch.stack(rewards, 1)


def _normal(outputs_BC: Tensor) -> Normal:
    mean, raw_std = outputs_BC.chunk(2, -1)
    # Without validation: the training loop reports values that are not finite.
    return Normal(mean, F.softplus(raw_std) + MIN_STD, validate_args=False)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    first, second = nn.Linear(inputs, hidden), nn.Linear(hidden, hidden)
    return nn.Sequential(first, nn.ReLU(), second, nn.ReLU(), nn.Linear(hidden, outputs))
