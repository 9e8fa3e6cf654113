"""The procedural categories: cameras, mugs, bowls and beds, from a seed; each knows its exact
convex parts.
"""

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
    """A mesh of a category in centimetres, z up; ``style`` counts through its designs, ``rng``
    varies proportions.
    """
    return GENERATORS[category](rng, style)
