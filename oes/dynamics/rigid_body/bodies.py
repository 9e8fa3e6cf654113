"""Objects on a table as rigid bodies: what they are and where."""

from dataclasses import dataclass

import torch
from torch import Tensor

from oes.config import params


@params
class ContactPhysics:
    """What is taken to be true of every object: a step's time, its parts and the rounds of contacts
    in each; coefficients of friction (against table, rod and each other), and the lever of that
    about a contact's normal; how far outside two outlines a contact begins; the rod's radius, and
    how high its tip is above the table.
    """

    step_s: float
    parts: int
    rounds: int
    table_friction: float
    rod_friction: float
    object_friction: float
    spinning_m: float
    margin_m: float
    rod_radius_m: float
    tip_m: float


@dataclass(frozen=True)
class RigidBodies:
    """N objects of B scenes in their own axes (the world's at t = 0).

    From their reference points: what the rod may touch and what others may (radii BNK; 0 where
    there is nothing), and the centre of mass BN2. From the centre of mass: feet BNM2, its height
    over them BN, and between which heights BNK the outline that the rod meets is reached. The
    inverse inertia for a mass of 1 BN33; how tall they are BN; mass and friction as multiples of
    the usual BN, and which exist BN.
    """

    rod_BNK: Tensor
    whole_BNK: Tensor
    mass_BN2: Tensor
    feet_BNM2: Tensor
    height_BN: Tensor
    rod_low_BNK: Tensor
    rod_high_BNK: Tensor
    inverse_BN33: Tensor
    tall_BN: Tensor
    heavy_BN: Tensor
    rough_BN: Tensor
    valid_BN: Tensor


@dataclass(frozen=True)
class Pose:
    """Where centres of mass are (BN2, world), how far objects have turned (BN), and their velocity
    (BN3: m/s, m/s, rad/s).
    """

    place_BN2: Tensor
    turn_BN: Tensor
    twist_BN3: Tensor


def rotate_bodies(vector_2: Tensor, angle: Tensor) -> Tensor:
    """Vectors ...2 turned by angles (broadcast)."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vector_2.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y], -1)
