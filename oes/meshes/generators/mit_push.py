"""The 11 MIT Push objects (Yu et al. 2016) from their published dimensions, without screw holes.

Outlines are in millimetres, seen from above: x is that of the original meshes, y their negated z,
as their thickness lies along y. The steel plates are 12.7 mm thick; here the height is free.
"""

from itertools import pairwise

import numpy as np
import shapely
import trimesh
from scipy.interpolate import CubicSpline

from oes.episode import Floats
from oes.meshes.generators.shapes import Shape, circle, convex_hull

PLATE_SECTIONS = 96
BUTTER_SLICES_MM = (-80.0, -22.92, -12.09, 0.0, 12.09, 22.92, 80.0)
BUTTER_QUADRANT_MM = (
    (27.37, 0.0),
    (30.78, 12.09),
    (37.34, 22.92),
    (43.99, 33.72),
    (47.71, 45.69),
    (44.1, 57.62),
    (35.46, 66.78),
    (24.6, 73.27),
    (12.58, 77.18),
    (0.0, 78.62),
)


def _rectangle(width: float, depth: float) -> Floats:
    x, y = width / 2, depth / 2
    return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])


def _triangle(leg_x: float, leg_y: float) -> Floats:
    """Right triangle with its corner at (45, -45)."""
    return np.array([[45.0, -45.0], [45.0, leg_y - 45.0], [45.0 - leg_x, -45.0]])


def _ellipse(semi_x: float, semi_y: float) -> Floats:
    return np.asarray(circle(PLATE_SECTIONS) * np.array([semi_x, semi_y]))


def _butterfly() -> Floats:
    """The waisted outline: a periodic cubic spline through 10 points of each quadrant."""
    quadrant = np.array(BUTTER_QUADRANT_MM)
    half = np.concatenate([quadrant, (quadrant * [-1, 1])[-2::-1]])
    knots = np.concatenate([half, (half * [1, -1])[-2::-1]])
    chord = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    spline = CubicSpline(chord, knots, bc_type="periodic")
    return np.asarray(spline(np.linspace(0, chord[-1], 2 * PLATE_SECTIONS, endpoint=False)))


OUTLINES_MM: dict[str, Floats] = {
    "rect1": _rectangle(90.0, 90.0),
    "rect2": _rectangle(90.0, 112.5),
    "rect3": _rectangle(135.0, 90.0),
    "tri1": _triangle(126.0, 126.0),
    "tri2": _triangle(151.2, 126.0),
    "tri3": _triangle(176.4, 126.0),
    "ellip1": _ellipse(52.4, 52.4),
    "ellip2": _ellipse(52.4, 65.5),
    "ellip3": _ellipse(52.4, 78.6),
    "hex": circle(6) * 60.54,
    "butter": _butterfly(),
}


def plate(name: str, longest_m: float, height_m: float) -> Shape:
    """The MIT Push object extruded along z, its longest horizontal side ``longest_m``."""
    scale = longest_m / float(np.ptp(OUTLINES_MM[name], axis=0).max())
    outline_P2 = OUTLINES_MM[name] * scale
    if name != "butter":
        return _prism(outline_P2, height_m)
    outline = shapely.Polygon(outline_P2)
    slices = [
        shapely.intersection(outline, shapely.box(-longest_m, low * scale, longest_m, high * scale))
        for low, high in pairwise(BUTTER_SLICES_MM)
    ]
    parts = [_prism(np.array(piece.exterior.coords), height_m).solid for piece in slices]
    return Shape(trimesh.creation.extrude_polygon(outline, height_m), tuple(parts))


def _prism(outline_P2: Floats, height: float) -> Shape:
    """Extrusion of a convex outline from z = 0."""
    return convex_hull(np.concatenate([np.insert(outline_P2, 2, z, axis=1) for z in (0.0, height)]))
