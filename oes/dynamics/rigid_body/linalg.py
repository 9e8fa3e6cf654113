"""Products of 3-vectors for compiled kernels, which would otherwise allocate arrays."""

from oes.episode import Floats
from oes.jit import jit

Vector = Floats | tuple[float, float, float]


@jit
def dot(a_3: Vector, b_3: Vector) -> float:
    """Scalar product, summed from the first component on."""
    found: float = a_3[0] * b_3[0] + a_3[1] * b_3[1] + a_3[2] * b_3[2]
    return found


@jit
def cross(a_3: Vector, b_3: Vector) -> tuple[float, float, float]:
    """Vector product."""
    return (
        a_3[1] * b_3[2] - a_3[2] * b_3[1],
        a_3[2] * b_3[0] - a_3[0] * b_3[2],
        a_3[0] * b_3[1] - a_3[1] * b_3[0],
    )
