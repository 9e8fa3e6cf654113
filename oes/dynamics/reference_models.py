"""The rows that bound the problem: nothing moves; and Bullet itself, with the mean mass and
friction.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from oes.dynamics.graph import ObjectState, StepMotion
from oes.dynamics.unroll import DynamicsModel
from oes.episode import Episode
from oes.objects import Objects


class Static(DynamicsModel):
    """The lower bound: nothing ever moves."""

    def appearance(self, objects: Objects) -> Tensor:
        """None: a tensor BN0."""
        return objects.center_N3[..., :0]

    def forward(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """No motion."""
        still = torch.zeros_like(state.center_BN3)
        return StepMotion(still, still)


class Simulator(nn.Module):
    """The upper bound: what cannot be known from images. It holds the mean mass and friction of the
    training bodies.

    It is no forecaster from images: ``oes.evaluation.forecasters`` re-runs Bullet from the true
    state with these two numbers.
    """

    mass_kg: Tensor
    friction: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mass_kg", torch.zeros(()))
        self.register_buffer("friction", torch.zeros(()))

    def measure(self, episodes: Sequence[Episode]) -> None:
        """Take the means over every body of ``episodes``."""
        bodies = [body for episode in episodes for body in episode.bodies]
        self.mass_kg.fill_(sum(body.mass_kg for body in bodies) / len(bodies))
        self.friction.fill_(sum(body.friction for body in bodies) / len(bodies))
