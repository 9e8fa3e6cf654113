"""Reference models that are not learned: no motion, and Bullet with mean mass and friction."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from oes.dynamics.graph import ObjectState, StepMotion, TipMotion
from oes.dynamics.unroll import DynamicsModel
from oes.episode import Episode
from oes.objects import Objects


class Static(DynamicsModel):
    """Lower reference: all objects stay at rest."""

    def appearance(self, objects: Objects) -> Tensor:
        """A tensor BN0."""
        return objects.center_N3[..., :0]

    def forward(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        """No motion."""
        zero_BN3 = torch.zeros_like(state.center_BN3)
        return StepMotion(zero_BN3, zero_BN3)


class Simulator(nn.Module):
    """Upper reference: Bullet from the true state, with the training bodies' mean parameters.

    Mass and friction cannot be known from images. ``oes.evaluation.forecasters`` runs it.
    """

    mass_kg: Tensor
    friction: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mass_kg", torch.zeros(()))
        self.register_buffer("friction", torch.zeros(()))

    def measure(self, episodes: Sequence[Episode]) -> None:
        """Set both to their means over all bodies of ``episodes``."""
        bodies = [body for episode in episodes for body in episode.bodies]
        self.mass_kg.fill_(sum(body.mass_kg for body in bodies) / len(bodies))
        self.friction.fill_(sum(body.friction for body in bodies) / len(bodies))
