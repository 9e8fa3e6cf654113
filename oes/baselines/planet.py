"""PlaNet at small size: a recurrent state-space model of pictures and rewards (Hafner et al. 2019;
appendix C.2).

As C.2 asks, the goals join the first fully connected layer after the picture's encoder, and the
reward of a state is minus its distance to the goals. Deviations: that layer is added (the original
has none), the reward head sees the goals too, the action says where the rod starts (pushes start
anywhere), and what differs from the mean picture weighs more in the loss, as objects cover a
hundredth of the picture.
"""

import itertools
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params

ACTION_DIM = 4  # the rod's place and its displacement
MIN_STD = 0.1


@params
class PlanetConfig:
    """``base``: channels of the first convolution, doubled by each of the four; sizes of the
    recurrent and the random part of the state, and of all fully connected layers; how many objects
    can have a goal.
    """

    base: int
    recurrent: int
    stochastic: int
    hidden: int
    goals: int


@dataclass(frozen=True)
class Gaussian:
    """Mean and standard deviation, BZ."""

    mean: Tensor
    std: Tensor

    def sample(self) -> Tensor:
        return self.mean + self.std * torch.randn_like(self.std)

    def kl(self, other: "Gaussian") -> Tensor:
        """To ``other``, summed over the dimensions: B."""
        ratio = (self.std / other.std) ** 2
        return 0.5 * (ratio + ((self.mean - other.mean) / other.std) ** 2 - 1 - ratio.log()).sum(-1)


@dataclass(frozen=True)
class LatentState:
    """The recurrent part BR and the random part BZ."""

    recurrent: Tensor
    random: Tensor

    def features(self) -> Tensor:
        return torch.cat([self.recurrent, self.random], -1)


class PlaNet(nn.Module):
    """Prior, posterior, picture and reward. Goals BGC: two coordinates of ``Overhead`` and whether
    there is one.
    """

    def __init__(self, cfg: PlanetConfig) -> None:
        super().__init__()
        self.cfg = cfg
        base, hidden, goals = cfg.base, cfg.hidden, 3 * cfg.goals
        widths = (3, base, 2 * base, 4 * base, 8 * base)
        convs = [
            nn.Sequential(nn.Conv2d(i, o, 4, 2), nn.ReLU()) for i, o in itertools.pairwise(widths)
        ]
        self.encoder = nn.Sequential(*convs, nn.Flatten())
        self.first = nn.Linear(32 * base, hidden)
        self.into = nn.Linear(cfg.stochastic + ACTION_DIM, hidden)
        self.gru = nn.GRUCell(hidden, cfg.recurrent)
        self.prior = _mlp(cfg.recurrent, hidden, 2 * cfg.stochastic)
        self.posterior = _mlp(cfg.recurrent + hidden + goals, hidden, 2 * cfg.stochastic)
        features = cfg.recurrent + cfg.stochastic
        self.widen = nn.Linear(features, 32 * base)
        self.decoder = nn.Sequential(
            nn.ConvTranspose2d(32 * base, 4 * base, 5, 2),
            nn.ReLU(),
            nn.ConvTranspose2d(4 * base, 2 * base, 5, 2),
            nn.ReLU(),
            nn.ConvTranspose2d(2 * base, base, 6, 2),
            nn.ReLU(),
            nn.ConvTranspose2d(base, 3, 6, 2),
        )
        self.reward = _mlp(features + goals, hidden, 1)

    def encode(self, frame_B3HW: Tensor) -> Tensor:
        """The first fully connected layer after the convolutions: BC."""
        return F.relu(self.first(self.encoder(frame_B3HW - 0.5)))

    def begin(self, batch: int, like: Tensor) -> LatentState:
        """The state before anything was seen: zeros."""
        return LatentState(
            like.new_zeros(batch, self.cfg.recurrent), like.new_zeros(batch, self.cfg.stochastic)
        )

    def imagine(self, state: LatentState, action_BA: Tensor) -> tuple[Tensor, Gaussian]:
        """The recurrent part after an action, and what the random part may then be."""
        hidden = F.relu(self.into(torch.cat([state.random, action_BA], -1)))
        recurrent = self.gru(hidden, state.recurrent)
        return recurrent, _gaussian(self.prior(recurrent))

    def look(self, recurrent_BR: Tensor, seen_BC: Tensor, goal_BG3: Tensor) -> Gaussian:
        """The random part, once a picture is seen."""
        return _gaussian(
            self.posterior(torch.cat([recurrent_BR, seen_BC, goal_BG3.flatten(1)], -1))
        )

    def decode(self, features_BC: Tensor) -> Tensor:
        """The picture of a state: B3HW, 0 to 1."""
        picture: Tensor = self.decoder(self.widen(features_BC)[..., None, None]) + 0.5
        return picture

    def rewards(self, features_BC: Tensor, goal_BG3: Tensor) -> Tensor:
        """Minus the mean distance to the goals (half pictures): B; or for any other leading
        dimensions.
        """
        found: Tensor = self.reward(torch.cat([features_BC, goal_BG3.flatten(-2)], -1))[..., 0]
        return found


def distance_to_goals(object_BN2: Tensor, goal_BG3: Tensor) -> Tensor:
    """Mean distance of the objects to the goals that exist (N = G): B."""
    exists_BG = goal_BG3[..., 2]
    distance_BG = (object_BN2 - goal_BG3[..., :2]).norm(dim=-1) * exists_BG
    mean_B: Tensor = distance_BG.sum(-1) / exists_BG.sum(-1).clamp(min=1)
    return mean_B


@torch.no_grad()
def unroll_latent(
    net: PlaNet, frame_3HW: Tensor, goal_G3: Tensor, tip_S2: Tensor, actions_SH2: Tensor
) -> tuple[Tensor, Tensor]:
    """States SHC and their rewards SH under S plans from one picture.

    The mean state is imagined, as samples would only add noise.
    """
    samples = len(tip_S2)
    goal_SG3 = goal_G3.expand(samples, -1, -1)
    seen = net.encode(frame_3HW[None]).expand(samples, -1)
    recurrent, _ = net.imagine(net.begin(samples, seen), seen.new_zeros(samples, ACTION_DIM))
    state = LatentState(recurrent, net.look(recurrent, seen, goal_SG3).mean)
    features, rewards = [], []
    for action_S2 in actions_SH2.unbind(1):
        recurrent, prior = net.imagine(state, torch.cat([tip_S2, action_S2], -1))
        state = LatentState(recurrent, prior.mean)
        features.append(state.features())
        rewards.append(net.rewards(features[-1], goal_SG3))
        tip_S2 = tip_S2 + action_S2
    return torch.stack(features, 1), torch.stack(rewards, 1)


def _gaussian(numbers_BZ: Tensor) -> Gaussian:
    mean, raw = numbers_BZ.chunk(2, -1)
    return Gaussian(mean, F.softplus(raw) + MIN_STD)


def _mlp(inputs: int, hidden: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(inputs, hidden),
        nn.ReLU(),
        nn.Linear(hidden, hidden),
        nn.ReLU(),
        nn.Linear(hidden, outputs),
    )
