"""Rigid bodies on a table: constants and state, as tensors and as arrays for the kernels."""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from oes.config import params
from oes.episode import Bools, Floats


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


class Bodies(NamedTuple):
    """``RigidBodies`` as arrays for the kernels.

    Vertices and supports are relative to the centre of mass. ``radius_BN`` bounds both profiles,
    ``normal_BND2`` are outward normals of ``profile_BND``, ``has_rod_BN`` is False where the rod
    can touch nothing.
    """

    rod_profile_BND: Floats
    rod_vertex_BND2: Floats
    rod_min_z_BND: Floats
    rod_max_z_BND: Floats
    profile_BND: Floats
    vertex_BND2: Floats
    normal_BND2: Floats
    com_offset_BN2: Floats
    com_height_BN: Floats
    radius_BN: Floats
    height_BN: Floats
    support_BNP3: Floats
    inverse_inertia_BN33: Floats
    mass_BN: Floats
    pair_friction_BN: Floats
    is_valid_BN: Bools
    has_rod_BN: Bools


class State(NamedTuple):
    """State of the bodies (world), changed in place by the kernels; twists are linear, angular.

    Sleeping bodies are not moved.
    """

    com_BN3: Floats
    rotation_BN33: Floats
    twist_BN6: Floats
    is_awake_BN: Bools
