"""Solid procedural textures: a colour for every point of an object, in its frame, from a seed."""

from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from oes.episode import SEG_TABLE, Floats
from oes.render.scene import RenderMesh
from oes.render.shade import CHECKER, GRADIENT, NOISE, PLAIN, STRIPES, WOOD

SEEDED_KINDS = (CHECKER, STRIPES, NOISE, GRADIENT)
# Cells are some pixels wide at 1 m and 128 x 128 pixels, so that a rotation of the object shows.
CELL_M = {
    CHECKER: (0.022, 0.034),
    STRIPES: (0.016, 0.026),
    NOISE: (0.020, 0.032),
    GRADIENT: (0.05, 0.08),
}
MAX_TILT_DEG = 15.0  # so that no cell border lies along a flat face
WOOD_RGB_23 = np.array([[0.78, 0.70, 0.59], [0.66, 0.56, 0.44]])


class Texture(NamedTuple):
    """A pattern of two colours (rows of ``rgb_23``, 0..1) over space in units of a cell."""

    kind: int
    rgb_23: Floats
    cell_m: float
    cell_T_obj_34: Floats


def texture_of(mesh: RenderMesh) -> Texture:
    """The texture of a mesh: the table's wood, a plain colour, or the one of its seed."""
    if mesh.seg_id == SEG_TABLE:
        return Texture(WOOD, WOOD_RGB_23, 1.0, np.eye(3, 4))
    if mesh.texture_seed is None:
        return Texture(PLAIN, np.tile(mesh.rgb_3, (2, 1)), 1.0, np.eye(3, 4))
    return seeded_texture(mesh.texture_seed)


def seeded_texture(seed: int) -> Texture:
    """One of ``SEEDED_KINDS`` in two distinct colours, of random direction, phase and cell size."""
    rng = np.random.default_rng(seed)
    kind = int(rng.choice(SEEDED_KINDS))
    cell_m = float(rng.uniform(*CELL_M[kind]))
    tilt_deg = rng.uniform(-MAX_TILT_DEG, MAX_TILT_DEG, 2)
    tilt = Rotation.from_euler("xy", tilt_deg, degrees=True)
    rotation = tilt * Rotation.from_euler("z", rng.uniform(0, 360), degrees=True)
    R, phase = rotation.as_matrix(), rng.uniform(0, 1, (3, 1))
    return Texture(kind, _two_colours(rng), cell_m, np.concatenate([R / cell_m, phase], axis=1))


def _two_colours(rng: np.random.Generator) -> Floats:
    """A vivid colour, and one that differs from it in hue and clearly in brightness."""
    hue = rng.uniform(0, 360)
    hues = np.array([hue, (hue + rng.uniform(90, 270)) % 360])
    saturations = rng.uniform(0.55, 0.9, 2)
    values = np.array([rng.uniform(0.8, 1.0), rng.uniform(0.35, 0.6)])
    hsv = np.stack([hues, saturations, values], axis=1)
    rgb = cv2.cvtColor(hsv[None].astype(np.float32), cv2.COLOR_HSV2RGB)[0].astype(np.float64)
    return np.asarray(rgb[rng.permutation(2)])
