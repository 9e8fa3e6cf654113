"""Procedural mugs and bowls (centimetres, z up)."""

from dataclasses import dataclass

import numpy as np

from oes.episode import Floats
from oes.meshes.generators.shapes import Shape, frustum, join, superellipse, tube, vessel

NUM_SECTIONS, NUM_BANDS, NUM_SECTORS, NUM_LEVELS = 48, 2, 12, 13


@dataclass(frozen=True)
class Cup:
    """Proportions of a mug: radii at foot, middle and lip, height, and the handle's curve."""

    foot: float
    belly: float
    lip: float
    height: float
    handle: str


CUPS = (
    Cup(foot=4.0, belly=4.0, lip=4.0, height=9.0, handle="round"),
    Cup(foot=3.0, belly=3.7, lip=4.2, height=9.5, handle="square"),
    Cup(foot=3.1, belly=4.6, lip=3.8, height=8.5, handle="ear"),
    Cup(foot=2.8, belly=4.0, lip=5.4, height=6.8, handle="ear"),
    Cup(foot=3.9, belly=3.3, lip=3.7, height=11.0, handle="round"),
    Cup(foot=4.4, belly=4.7, lip=4.7, height=6.6, handle="square"),
)


def mug(rng: np.random.Generator, style: int) -> Shape:
    """A mug with a cavity and a handle on its +x side."""
    cup = CUPS[style % len(CUPS)]
    height = cup.height * rng.uniform(0.94, 1.06)
    wall, floor = rng.uniform(0.32, 0.42), rng.uniform(0.5, 0.7)
    radii = np.array([cup.foot, cup.belly, cup.lip]) * rng.uniform(0.97, 1.03, 3)
    z_R = np.linspace(0, height, NUM_LEVELS)
    inner_z_R = np.linspace(floor, height, NUM_LEVELS)
    outer_R2 = np.stack([_radius(radii, z_R / height), z_R], 1)
    inner_R2 = np.stack([_radius(radii, inner_z_R / height) - wall, inner_z_R], 1)
    body = vessel(outer_R2, inner_R2, superellipse(NUM_SECTIONS, 2.0, 1.0), NUM_BANDS, NUM_SECTORS)
    width = rng.uniform(0.5, 0.7)
    path_P3 = _handle(cup.handle, radii - wall / 2, height, rng.uniform(2.2, 2.8))
    return join(body, tube(path_P3, width, 0.6 * width, 12, 6))


def _radius(radii_3: Floats, level_R: Floats) -> Floats:
    """The parabola through foot, belly and lip at levels 0, 1/2 and 1."""
    return np.asarray(np.polyval(np.polyfit([0.0, 0.5, 1.0], radii_3, 2), level_R))


def _handle(kind: str, radii_3: Floats, height: float, reach: float) -> Floats:
    """The handle's centre line P3, from inside the wall above to inside the wall below."""
    exponent, droop = {"round": (2.0, 0.0), "square": (4.5, 0.0), "ear": (2.4, 0.28)}[kind]
    angle_P = np.linspace(np.pi / 2, -np.pi / 2, 25)
    along_P, up_P = np.cos(angle_P), np.sin(angle_P)
    stretch_P = (np.abs(along_P) ** exponent + np.abs(up_P) ** exponent) ** (-1 / exponent)
    level_P = 0.53 + 0.31 * up_P * stretch_P
    out_P = along_P * stretch_P * reach * (1 + droop * up_P)
    x_P = _radius(radii_3, level_P) + out_P
    return np.stack([x_P, np.zeros_like(x_P), level_P * height], 1)


@dataclass(frozen=True)
class Dish:
    """Proportions of a bowl: depth over lip radius, foot, wall, outline and optional grips."""

    depth: float
    foot: float
    curve: float
    exponent: float
    aspect: float
    has_grips: bool


DISHES = (
    Dish(depth=0.92, foot=0.42, curve=2.2, exponent=2.0, aspect=1.0, has_grips=False),
    Dish(depth=0.70, foot=0.50, curve=1.9, exponent=2.0, aspect=1.0, has_grips=False),
    Dish(depth=0.78, foot=0.55, curve=2.6, exponent=4.0, aspect=1.0, has_grips=False),
    Dish(depth=0.76, foot=0.45, curve=2.4, exponent=2.0, aspect=0.72, has_grips=False),
    Dish(depth=0.90, foot=0.50, curve=3.0, exponent=2.0, aspect=1.0, has_grips=True),
    Dish(depth=1.10, foot=0.34, curve=1.5, exponent=2.0, aspect=1.0, has_grips=False),
)


def bowl(rng: np.random.Generator, style: int) -> Shape:
    """A bowl on a foot; the wall is a power curve from the foot to the lip."""
    dish = DISHES[style % len(DISHES)]
    lip, depth = 6.0, 6.0 * dish.depth * rng.uniform(0.92, 1.08)
    base = lip * dish.foot * rng.uniform(0.92, 1.08)
    wall, curve = rng.uniform(0.38, 0.48), dish.curve * rng.uniform(0.95, 1.05)
    outline_D2 = superellipse(NUM_SECTIONS, dish.exponent, dish.aspect)
    outer_R2 = _wall(base, lip, depth, curve)
    inner_R2 = _wall(base - 0.4 * wall, lip - wall, depth - 1.3 * wall, curve)
    inner_R2 = inner_R2 + np.array([0.0, 1.3 * wall])
    body = vessel(outer_R2, inner_R2, outline_D2, NUM_BANDS, NUM_SECTORS).moved((0, 0, 0.45))
    foot = frustum(0.94 * base, 0.9 * base, 0.6, NUM_SECTIONS)
    stretch = np.diag([1.0, dish.aspect, 1.0, 1.0])
    shapes = [body, foot.mapped(stretch)]
    if dish.has_grips:
        shapes += _grips(lip - wall / 2, 0.45 + 0.86 * depth)
    return join(*shapes)


def _wall(low: float, high: float, depth: float, curve: float) -> Floats:
    """(radius, z) from foot to lip; with ``curve`` above 1 the wall steepens upwards."""
    t_R = np.linspace(0, 1, NUM_LEVELS)
    return np.stack([low + (high - low) * (1 - (1 - t_R) ** curve), depth * t_R**1.25], 1)


def _grips(radius: float, z: float) -> list[Shape]:
    """Two loops beside the lip, at +x and -x, flat in a horizontal plane."""
    angle_P = np.linspace(np.pi / 2, -np.pi / 2, 17)
    path_P3 = np.stack(
        [radius - 0.25 + 1.7 * np.cos(angle_P), np.zeros(17), 1.9 * np.sin(angle_P)], 1
    )
    lying = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, z], [0, 0, 0, 1]])
    grip = tube(path_P3, 0.35, 0.4, 12, 6).mapped(lying)
    return [grip, grip.mapped(np.diag([-1.0, -1.0, 1.0, 1.0]))]
