"""Array types and vector products that the compiled kernels share.

Tuples of arrays must stand in files with compiled functions: only these decide whether cached
machine code is current (``oes.jit.cache_dir``).
"""

from typing import NamedTuple

from oes.episode import Bools, Floats
from oes.jit import jit

Vector = Floats | tuple[float, float, float]


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


class StepSettings(NamedTuple):
    """``ContactPhysics`` for the kernels; ``dt`` (seconds) is one substep.

    ``rod_radius_m`` includes the contact margin ``margin_m``.
    """

    dt: float
    substeps: int
    iterations: int
    spinning_m: float
    rod_radius_m: float
    tip_height_m: float
    margin_m: float


@jit
def dot(a_3: Vector, b_3: Vector) -> float:
    """Scalar product, summed from the first component on."""
    product: float = a_3[0] * b_3[0] + a_3[1] * b_3[1] + a_3[2] * b_3[2]
    return product


@jit
def cross(a_3: Vector, b_3: Vector) -> tuple[float, float, float]:
    """Vector product."""
    return (
        a_3[1] * b_3[2] - a_3[2] * b_3[1],
        a_3[2] * b_3[0] - a_3[0] * b_3[2],
        a_3[0] * b_3[1] - a_3[1] * b_3[0],
    )
