"""The procedural categories, cameras, mugs, bowls and beds, with exact convex parts."""

from collections.abc import Callable

import numpy as np

from oes.meshes.generators.beds import bed
from oes.meshes.generators.cameras import camera
from oes.meshes.generators.shapes import Shape
from oes.meshes.generators.vessels import bowl, mug

GENERATORS: dict[str, Callable[[np.random.Generator, int], Shape]] = {
    "camera": camera,
    "mug": mug,
    "bowl": bowl,
    "bed": bed,
}


def generate(category: str, style: int, rng: np.random.Generator) -> Shape:
    """A mesh in centimetres, z up; ``style`` selects a design, ``rng`` varies its proportions."""
    return GENERATORS[category](rng, style)
