"""Objects on a table seen from above, as rigid bodies in the plane: what they are and where."""

from dataclasses import dataclass

import torch
from torch import Tensor

from oes.config import params


@params
class Physics:
    """What is taken to be true of every object: a step's time and its parts, coefficients of friction (against table,
    rod and each other), how far outside its outline a contact begins, how far ahead of its middle a sliding object
    leans on the table, where it stands (as a share of its foot's outline), its radius of gyration (as a multiple of a
    prism's of its outline), the rod's radius, and rounds of contacts."""

    step_s: float
    parts: int
    table_friction: float
    rod_friction: float
    object_friction: float
    margin_m: float
    lean_m: float
    stance: float
    gyration: float
    rod_radius_m: float
    rounds: int


@dataclass(frozen=True)
class Bodies:
    """N objects of B scenes in their own axes (the world's at t = 0), from their reference points: what the rod may
    touch and what others may (radii BNK; 0 where there is nothing), points of support BNM2 (from the centre of mass)
    and how much each is thought to bear BNM, the centre of mass BN2, the
    radius of gyration BN, the mass and the friction as multiples of the usual BN, and which exist BN."""

    rod_BNK: Tensor
    whole_BNK: Tensor
    support_BNM2: Tensor
    share_BNM: Tensor
    mass_BN2: Tensor
    gyration_BN: Tensor
    heavy_BN: Tensor
    rough_BN: Tensor
    valid_BN: Tensor


@dataclass(frozen=True)
class Pose:
    """Where centres of mass are (BN2, world), how far objects have turned (BN), and their velocity (BN3: m/s, m/s,
    rad/s)."""

    place_BN2: Tensor
    turn_BN: Tensor
    twist_BN3: Tensor


def turned(vector_2: Tensor, angle: Tensor) -> Tensor:
    """Vectors ...2 turned by angles (broadcast)."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vector_2.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y], -1)
