"""The toy blocks of Janner et al. 2019 (paper appendix B), from their published dimensions.

In the original units (a cube is 2 x 2 x 2), z up, standing as the originals do.
"""

from itertools import pairwise

import numpy as np

from oes.episode import Floats
from oes.meshes.generators.shapes import Shape, circle, convex_hull, frustum, ring, shell, slab

BLOCK_SECTIONS = 32
ARCH_SECTIONS = 16
ARCH_RADIUS = 1.25


def _box(width: float, depth: float, height: float) -> Shape:
    x = width / 2
    return slab([(-x, 0), (x, 0), (x, height), (-x, height)], depth)


def _wedge(apex_x: float, height: float) -> Shape:
    """A prism on a 2 x 2 base whose edge on top, along y, is above ``apex_x``."""
    return slab([(-1, 0), (1, 0), (apex_x, height)], 2)


def _arc(radius: float, num_sections: int) -> Floats:
    """Half a circle (x, z), from +x to -x."""
    return np.asarray(radius * circle(2 * num_sections)[: num_sections + 1])


def _cone() -> Shape:
    return convex_hull([*ring(1, 0, BLOCK_SECTIONS), (0, 0, 2)])


def _pyramid() -> Shape:
    """The original's tetrahedron: a pyramid on a square base."""
    return convex_hull([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (0, 0, 2)])


def _hat() -> Shape:
    """A roof as long along x as the legs of its right angle."""
    half = 2**0.5
    return convex_hull([(x, y, z) for x in (-1, 1) for y, z in ((-half, 0), (half, 0), (0, half))])


def _arch() -> Shape:
    """A brick with half a cylinder cut out from below: wedges about the cylinder's axis."""
    ray_D2 = _arc(1, ARCH_SECTIONS)
    gate_D2, wall_D2 = ARCH_RADIUS * ray_D2, 2 * ray_D2 / np.abs(ray_D2).max(1, keepdims=True)
    sides = (-1, -1, 1, 1)
    rings = [
        np.stack([np.insert(edge, 1, y) for edge, y in zip((a, b, b, a), sides, strict=True)])
        for a, b in zip(gate_D2, wall_D2, strict=True)
    ]
    parts = [convex_hull(np.concatenate(pair)).solid for pair in pairwise(rings)]
    return Shape(shell(np.stack(rings)), tuple(parts))


# family -> name -> block; a split holds out one of each family
BLOCKS: dict[str, dict[str, Shape]] = {
    "boxes": {
        "cube": _box(2, 2, 2),
        "rectangle": _box(2, 2, 4),
        "horizontal_rectangle": _box(4, 2, 2),
        "half_rectangle": _box(4, 2, 1),
    },
    "wedges": {
        "triangle": _wedge(-1, 2),
        "tall_triangle": _wedge(-1, 4),
        "middle_triangle": _wedge(0, 2),
    },
    "rounds": {
        "cylinder": frustum(1, 1, 2, BLOCK_SECTIONS),
        "cone": _cone(),
        "dome": slab(_arc(1, BLOCK_SECTIONS), 2),
    },
    "others": {"tetrahedron": _pyramid(), "hat": _hat(), "arch": _arch()},
}
