"""Rigid bodies on a table: shapes, mass properties and planar state."""

from dataclasses import dataclass

import torch
from torch import Tensor

from oes.config import params


@params
class ContactPhysics:
    """Nominal constants of the contact simulation; the same for every object.

    ``step_s``: duration of an action, integrated in ``substeps``.
    ``solver_iterations``: Gauss-Seidel sweeps over all contacts a substep.
    ``*_friction``: Coulomb coefficients of objects against table, rod and each other.
    ``spinning_friction_m``: friction torque about the contact normal, per unit normal force.
    ``contact_margin_m``: gap at which two surfaces count as in contact.
    ``rod_radius_m``, ``tip_height_m``: the rod, and its tip's height over the table.
    """

    step_s: float
    substeps: int
    solver_iterations: int
    table_friction: float
    rod_friction: float
    object_friction: float
    spinning_friction_m: float
    contact_margin_m: float
    rod_radius_m: float
    tip_height_m: float


@dataclass(frozen=True)
class RigidBodies:
    """N objects of B scenes in their body axes (parallel to the world's at t = 0), metres.

    rod_profile_BND      radii about the reference point that the rod can touch; 0 = nothing
    profile_BND          radii about the reference point that other objects can touch
    com_offset_BN2       centre of mass from the reference point
    support_BNP2         support points on the table, from the centre of mass
    com_height_BN        height of the centre of mass over the table
    rod_min_z_BND        lower end of the surface behind ``rod_profile``, from the centre of mass
    rod_max_z_BND        upper end of it
    inverse_inertia_BN33 inverse inertia tensor at mass 1
    height_BN            height of the object
    mass_factor_BN       mass over the nominal mass
    friction_factor_BN   friction over the nominal friction
    valid_BN             False for padding
    """

    rod_profile_BND: Tensor
    profile_BND: Tensor
    com_offset_BN2: Tensor
    support_BNP2: Tensor
    com_height_BN: Tensor
    rod_min_z_BND: Tensor
    rod_max_z_BND: Tensor
    inverse_inertia_BN33: Tensor
    height_BN: Tensor
    mass_factor_BN: Tensor
    friction_factor_BN: Tensor
    valid_BN: Tensor


@dataclass(frozen=True)
class PlanarState:
    """Centres of mass (world, metres), yaws (rad) and twists (m/s, m/s, rad/s)."""

    com_BN2: Tensor
    yaw_BN: Tensor
    twist_BN3: Tensor


def rotate_2d(vector_2: Tensor, angle: Tensor) -> Tensor:
    """Vectors ...2 rotated counter-clockwise by angles ... (broadcast)."""
    cos, sin = angle.cos(), angle.sin()
    x, y = vector_2.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y], -1)
