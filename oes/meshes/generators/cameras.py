"""Procedural cameras (centimetres, z up, the lens looks along +y)."""

import numpy as np

from oes.meshes.generators.shapes import Shape, block, convex_hull, frustum, join, ring, slab

CAMERA_SECTIONS = 40


def camera(rng: np.random.Generator, style: int) -> Shape:
    """A camera standing on its base."""
    return CAMERA_STYLES[style % len(CAMERA_STYLES)](rng)


def _reflex(rng: np.random.Generator) -> Shape:
    """Single-lens reflex: pentaprism hump, deep grip, long lens."""
    width, height, depth = rng.uniform(12.5, 14.0), rng.uniform(7.6, 8.4), rng.uniform(4.2, 5.0)
    body = block((width, depth, height), (0, 0, height / 2), 0.6)
    grip = block((2.8, depth + 2.4, height - 0.3), (1.4 - width / 2, 0.9, height / 2 - 0.15), 0.8)
    prism = slab(
        [(-2.9, height - 0.5), (2.9, height - 0.5), (1.5, height + 2.1), (-1.5, height + 2.1)],
        depth + 0.8,
    )
    hot_shoe = block((1.5, 1.8, 0.5), (0, -0.6, height + 2.2), 0.1)
    lens = _lens(depth / 2, 0.52 * height, (3.5, 3.2, 3.4), (1.6, rng.uniform(2.2, 3.6), 1.0))
    dial = frustum(1.15, 1.05, 1.2, 24).moved((width / 2 - 1.9, -0.2, height - 0.3))
    button = frustum(0.65, 0.55, 0.9, 24).moved((1.4 - width / 2, 1.3, height - 0.6))
    return join(body, grip, prism, hot_shoe, lens, dial, button)


def _rangefinder(rng: np.random.Generator) -> Shape:
    """Flat body with rounded ends, a stepped top plate, a short lens and three knobs."""
    width, height, depth = rng.uniform(13.2, 14.4), rng.uniform(6.4, 7.0), rng.uniform(3.0, 3.5)
    body = _rounded(width, depth, height)
    plate = block((width - 3.2, depth - 0.4, 1.4), (0.4, 0, height + 0.4), 0.2)
    lens = _lens(depth / 2, 0.47 * height, (2.9, 2.5), (1.2, rng.uniform(1.4, 2.2)))
    window = block((1.9, 0.6, 1.0), (-width / 2 + 3.6, depth / 2 - 0.2, height + 0.45), 0.12)
    small = block((1.1, 0.5, 0.8), (0.6, depth / 2 - 0.2, height + 0.45), 0.12)
    end = width / 2
    sizes = [(1.5 - end, 1.1, 1.3), (end - 1.4, 1.2, 1.1), (end - 4.0, 0.85, 2.1)]
    knobs = [frustum(r, 0.93 * r, h, 28).moved((x, 0, height - 0.3)) for x, r, h in sizes]
    return join(body, plate, lens, window, small, *knobs)


def _compact(rng: np.random.Generator) -> Shape:
    """Pocket camera: a rounded body, one telescoping lens, a flash window and a button."""
    width, height, depth = rng.uniform(9.6, 10.6), rng.uniform(6.2, 6.8), rng.uniform(3.2, 3.8)
    body = _rounded(width, depth, height)
    lens = _lens(
        depth / 2, 0.48 * height, (2.6, 2.2, 1.8), (0.7, 0.9, rng.uniform(0.8, 1.3))
    ).moved((0.9, 0, 0))
    flash = block((1.9, 0.6, 0.9), (-width / 2 + 2.4, depth / 2, height - 1.1), 0.15)
    button = frustum(0.75, 0.65, 0.8, 24).moved((-width / 2 + 2.4, 0, height - 0.3))
    ridge = block((0.7, 0.7, height - 2.4), (-width / 2 + 1.3, depth / 2, height / 2 - 0.4), 0.2)
    return join(body, lens, flash, button, ridge)


def _instant(rng: np.random.Generator) -> Shape:
    """Instant camera: a wedge-shaped body, a wide nose with a slot, a small lens, a flash."""
    width, height, depth = rng.uniform(10.5, 11.5), rng.uniform(9.0, 9.8), rng.uniform(8.2, 9.2)
    back, front = -depth / 2, depth / 2
    side_yz = [
        (back, 0),
        (front, 0),
        (front, 3.6),
        (front - 2.2, height - 0.6),
        (front - 2.8, height),
        (back + 1.6, height),
        (back, 4.6),
    ]
    body = convex_hull([(x, y, z) for x in (-width / 2, width / 2) for y, z in side_yz])
    nose = block((width - 0.8, 2.2, 2.6), (0, front + 0.4, 1.5), 0.35)
    slot = block((width - 2.6, 1.0, 0.5), (0, front + 1.5, 1.5), 0.1)
    lens = _lens(front - 2.0, 0.56 * height, (2.3, 1.9), (2.2, 0.8))
    flash = block((width - 2.0, 2.0, 1.9), (0, front - 3.3, height + 0.4), 0.3)
    finder = block((1.9, 1.4, 1.7), (width / 2 - 1.9, front - 1.9, height - 1.7), 0.25)
    return join(body.cut(slot), nose.cut(slot), lens, flash, finder)


def _box(rng: np.random.Generator) -> Shape:
    """Twin-lens box camera: a tall body, two lenses, a raised hood and two knobs."""
    width, height, depth = rng.uniform(7.4, 8.2), rng.uniform(10.2, 11.2), rng.uniform(8.0, 8.8)
    body = block((width, depth, height), (0, 0, height / 2), 0.5)
    hood = block((width - 1.6, depth - 2.2, 1.8), (0, -0.3, height + 0.6), 0.25)
    well = block((width - 2.6, depth - 3.2, 1.2), (0, -0.3, height + 1.4), 0.05)
    plate = block((width - 1.0, 1.6, height - 1.4), (0, depth / 2 + 0.3, height / 2), 0.4)
    taking = _lens(depth / 2 + 0.8, 0.29 * height, (2.2, 1.9), (1.0, 0.8))
    viewing = _lens(depth / 2 + 0.8, 0.70 * height, (2.1, 1.8), (0.9, 0.7))
    knobs = [
        frustum(r, 0.9 * r, 1.6, 28).turned("x").moved((width / 2 - 0.4, y, z))
        for r, y, z in ((1.5, 0.6, 3.4), (1.1, -1.0, 7.4))
    ]
    return join(body, hood.cut(well), plate, taking, viewing, *knobs)


def _bridge(rng: np.random.Generator) -> Shape:
    """Superzoom: a slim body, a sloping viewfinder, a swollen grip and a long stepped barrel."""
    width, height, depth = rng.uniform(11.0, 12.0), rng.uniform(7.6, 8.2), rng.uniform(4.0, 4.6)
    body = _rounded(width, depth, height - 0.4)
    grip = convex_hull(np.concatenate([ring(1.9, 0.3, 24), ring(1.6, height - 0.2, 24)])).moved(
        (1.7 - width / 2, 1.6, 0)
    )
    hump = slab(
        [(-2.4, height - 1.2), (2.6, height - 1.2), (1.2, height + 1.5), (-1.6, height + 1.5)],
        depth + 1.4,
    )
    lens = _lens(depth / 2, 0.5 * height, (3.5, 3.1, 2.7), (2.0, 1.5, rng.uniform(0.8, 1.4))).moved(
        (0.7, 0, 0)
    )
    button = frustum(0.7, 0.6, 0.9, 24).moved((1.7 - width / 2, 1.8, height - 0.5))
    dial = frustum(0.95, 0.9, 1.2, 24).moved((width / 2 - 1.9, -0.4, height - 0.9))
    return join(body, grip, hump, lens, button, dial)


def _lens(y: float, z: float, radii: tuple[float, ...], lengths: tuple[float, ...]) -> Shape:
    """Stepped barrel from the body's face at ``y``, with a domed glass in its hollow mouth."""
    barrels, start = [], y - 0.5
    for radius, length in zip(radii, lengths, strict=True):
        barrel = frustum(radius, 0.97 * radius, length + 0.5, CAMERA_SECTIONS).turned("y")
        barrels.append(barrel.moved((0, start, z)))
        start += length
    mouth, end = 0.8 * radii[-1], start + 0.5
    recess = frustum(0.8 * mouth, mouth, 0.8, CAMERA_SECTIONS).turned("y")
    recess = recess.moved((0, end - 0.55, z))
    levels = [(0.78 * mouth * np.cos(a), 0.3 * np.sin(a)) for a in np.linspace(0, 1.2, 5)]
    rings = [ring(r, h, CAMERA_SECTIONS) for r, h in ((0.78 * mouth, -0.3), *levels)]
    glass = convex_hull(np.concatenate(rings)).turned("y")
    barrels[-1] = barrels[-1].cut(recess)
    return join(*barrels, Shape(glass.solid, ()).moved((0, end - 0.6, z)))


def _rounded(width: float, depth: float, height: float) -> Shape:
    """A body with half-round ends and slightly bevelled base and top."""
    r = depth / 2
    levels = ((r - 0.2, 0), (r, 0.25), (r, height - 0.25), (r - 0.2, height))
    outline = np.concatenate([ring(radius, z, 32) for radius, z in levels])
    shift = np.array([(width - depth) / 2, 0, 0])
    return convex_hull(np.concatenate([outline - shift, outline + shift]))


CAMERA_STYLES = (_reflex, _rangefinder, _compact, _instant, _box, _bridge)
