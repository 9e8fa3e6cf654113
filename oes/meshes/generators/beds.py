"""Procedural beds (centimetres, z up, the head at -y)."""

import numpy as np

from oes.meshes.generators.shapes import Shape, block, convex_hull, frustum, join, ring, slab


def bed(rng: np.random.Generator, style: int) -> Shape:
    """A bed standing on its legs."""
    return BED_STYLES[style % len(BED_STYLES)](rng)


def _panel(rng: np.random.Generator) -> Shape:
    """Single bed with an arched headboard, a lower footboard and one pillow."""
    width, length = rng.uniform(98, 112), rng.uniform(196, 208)
    head = _board(width + 8, rng.uniform(92, 104), 22, 9).moved((0, -length / 2 - 2, 0))
    foot = _board(width + 8, 58, 10, 9).moved((0, length / 2 + 2, 0))
    return join(head, foot, *_berth(width, length, 26), *_pillows(width, length, 49, 1))


def _slatted(rng: np.random.Generator) -> Shape:
    """Double bed: a headboard of slats between posts, legs, two pillows, a folded blanket."""
    width, length, height = rng.uniform(140, 156), rng.uniform(196, 206), rng.uniform(100, 112)
    y = -length / 2 - 2
    posts = [block((12, 12, height), (side * (width / 2), y, height / 2), 1.5) for side in (-1, 1)]
    rails = [block((width, 7, 12), (0, y, z), 1) for z in (30, height - 10)]
    slats = [
        block((10, 5, height - 36), (x, y, height / 2 + 8), 0.8)
        for x in np.linspace(-0.36, 0.36, 5) * width
    ]
    fold = block((width + 3, 60, 9), (0, 0.22 * length, 46), 2.5)
    legs = _legs(width, length, 14, 6)[2:]
    soft = [*_berth(width, length, 27), *_pillows(width, length, 49, 2)]
    return join(*posts, *rails, *slats, fold, *legs, *soft)


def _sleigh(rng: np.random.Generator) -> Shape:
    """Sleigh bed: both ends lean outwards and finish in a roll."""
    width, length = rng.uniform(118, 132), rng.uniform(190, 200)
    ends = []
    for y, height, out in ((-length / 2, rng.uniform(88, 98), -1), (length / 2, 66, 1)):
        base = [
            (x, y + dy, z)
            for x in (-width / 2 - 4, width / 2 + 4)
            for dy, z in ((-6, 0), (6, 0), (6 + 14 * out, height), (-6 + 14 * out, height))
        ]
        roll = frustum(9, 9, width + 12, 28).turned("x")
        roll = roll.moved((-width / 2 - 6, y + 17 * out, height - 3))
        ends += [convex_hull(base), roll]
    return join(*ends, *_berth(width, length, 24), *_pillows(width, length, 47, 2))


def _canopy(rng: np.random.Generator) -> Shape:
    """Four-poster: posts, a frame on top, a low headboard and two pillows."""
    width, length, height = rng.uniform(138, 150), rng.uniform(192, 202), rng.uniform(150, 168)
    posts = _posts(11, width, length, height)
    long = [block((9, length, 9), (x * width / 2, 0, height - 5), 1) for x in (-1, 1)]
    wide = [block((width, 9, 9), (0, y * length / 2, height - 5.5), 1) for y in (-1, 1)]
    head = _board(width - 4, 88, 14, 7).moved((0, -length / 2, 0))
    soft = [*_berth(width, length, 28), *_pillows(width, length, 51, 2)]
    return join(*posts, *long, *wide, head, *soft)


def _bunk(rng: np.random.Generator) -> Shape:
    """Bunk bed: two berths between four posts, guard rails above and a ladder at one side."""
    width, length, height = rng.uniform(100, 112), rng.uniform(194, 204), rng.uniform(142, 154)
    posts = _posts(12, width, length, height)
    rails = [block((7, length, 9), (x * width / 2, 0, height - 7), 1) for x in (-1, 1)]
    ends = [
        block((width, 7, 10), (0, y * length / 2, z), 1) for y in (-1, 1) for z in (height - 8, 62)
    ]
    ladder = [block((6, 6, height - 10), (width / 2 + 9, y, height / 2 - 5), 0.8) for y in (24, 60)]
    rungs = [block((5, 40, 5), (width / 2 + 9, 42, z), 0.6) for z in (22, 48, 74, 100, 124)]
    hooks = [block((12, 5, 6), (width / 2 + 5, y, height - 14), 0.6) for y in (24, 60)]
    berths = [*_berth(width, length, 22), *_berth(width, length, 92)]
    pillows = [*_pillows(width, length, 45, 1), *_pillows(width, length, 115, 1)]
    return join(*posts, *rails, *ends, *ladder, *rungs, *hooks, *berths, *pillows)


def _platform(rng: np.random.Generator) -> Shape:
    """Low wide bed: a plinth wider than the mattress, a headboard of three cushions."""
    width, length = rng.uniform(158, 172), rng.uniform(198, 206)
    plinth = block((width + 22, length + 16, 16), (0, 0, 18), 2)
    foot = block((width - 14, length - 14, 14), (0, 0, 7), 1)
    mattress = block((width, length - 4, 26), (0, 2, 38), 5)
    head = block((width + 22, 9, 84), (0, -length / 2 - 5, 44), 2)
    cushions = [
        block((width / 3 + 2, 12, 42), (x * (width / 3 + 4), -length / 2 + 2, 64), 4)
        for x in (-1, 0, 1)
    ]
    return join(plinth, foot, mattress, head, *cushions, *_pillows(width, length - 14, 50, 2))


def _posts(thick: float, width: float, length: float, height: float) -> list[Shape]:
    """Square posts at the four corners."""
    center = width / 2, length / 2, height / 2
    return [
        block((thick, thick, height), np.multiply((x, y, 1), center), 1.5)
        for x in (-1, 1)
        for y in (-1, 1)
    ]


def _berth(width: float, length: float, z: float) -> list[Shape]:
    """Bed frame at height ``z`` with a mattress upon it (its top at z + 23)."""
    frame = block((width, length, 12), (0, 0, z), 1.5)
    return [frame, block((width - 5, length - 5, 20), (0, 0, z + 13), 4)]


def _legs(width: float, length: float, thick: float, inset: float) -> list[Shape]:
    """Tapered legs: two at the head (first), two at the foot."""
    leg = frustum(0.38 * thick, 0.6 * thick, 30, 20)
    return [
        leg.moved((x * (width / 2 - inset), y * (length / 2 - inset), 0))
        for y in (-1, 1)
        for x in (-1, 1)
    ]


def _board(width: float, height: float, rise: float, thick: float) -> Shape:
    """A panel with an arched top that also is its pair of legs."""
    t_P = np.linspace(np.pi, 0, 17)
    arch = np.stack([np.cos(t_P) * width / 2, height - rise + np.sin(t_P) * rise], 1)
    return slab(np.concatenate([[(-width / 2, 0), (width / 2, 0)], arch]), thick)


def _pillows(width: float, length: float, z: float, count: int) -> list[Shape]:
    """Flattened cushions on the mattress' head end."""
    share = (width - 14) / count
    span, deep, high = min(share - 4, 66), 40, 13
    profile = [(1.0, 0.0), (0.98, 0.45), (0.86, 0.8), (0.6, 1.0)]
    levels = [(share, z_share) for share, up in profile for z_share in (up, -up)]
    rings = [_cushion(span * s, deep * s, up * high / 2) for s, up in levels]
    cushion = convex_hull(np.concatenate(rings))
    offsets = (np.arange(count) - (count - 1) / 2) * share
    return [cushion.moved((x, -length / 2 + 10 + deep / 2, z + 2)) for x in offsets]


def _cushion(span: float, deep: float, z: float) -> np.ndarray:
    """A rounded-rectangle ring of a pillow."""
    points = ring(1.0, 0.0, 24)
    stretch = (np.abs(points[:, :2]) ** 4).sum(1, keepdims=True) ** -0.25
    return np.concatenate([points[:, :2] * stretch * (span / 2, deep / 2), np.full((24, 1), z)], 1)


BED_STYLES = (_panel, _slatted, _sleigh, _canopy, _bunk, _platform)
