"""Pushes worth imagining: an object, a free start beside what is perceived of it, a direction and a length."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from oes.config import params
from oes.control.plan import PlanError, Proposals
from oes.episode import Floats


@params
class Push:
    """How pushes are proposed.

    ``candidates`` of ``horizon_steps`` actions are kept of ``candidates * attempts`` drawn. Each action's length is
    uniform in ``length_m``; the rod starts ``clearance_m`` (range) short of the perceived outline on a line that passes
    the object's middle by up to ``aim`` times half its width; later actions turn by up to ``turn_deg``.
    """

    candidates: int
    horizon_steps: int
    attempts: int
    length_m: tuple[float, float]
    clearance_m: tuple[float, float]
    aim: float
    turn_deg: float


@dataclass(frozen=True)
class Rod:
    """The pushing rod, a vertical cylinder, in metres: its radius, the height of its tip, and how far it may go.

    The tip stays within ``reach_m`` of the table's centre along x and along y.
    """

    radius_m: float
    tip_height_m: float
    reach_m: float


@dataclass(frozen=True)
class Footprint:
    """What the rod must not start in: the perceived object seen from above, as points and the cell they stand for."""

    center_2: Floats
    points_P2: Floats
    cell_m: float


class NoFreeStart(PlanError):
    """No point beside any object is free for the rod."""


def footprint(
    center_3: Floats, size_3: Floats, occupancy_XYZ: NDArray[np.float32], voxel_m: float, threshold: float
) -> Footprint:
    """Outline of an object from its completed mask, over all heights: the rod is a vertical cylinder.

    A mask with no voxel above ``threshold`` (0..1) gives the box instead, sampled at the voxel size.
    """
    columns_XY = (occupancy_XYZ > threshold).any(axis=2)
    if columns_XY.any():
        cells_P2 = np.argwhere(columns_XY) + 0.5
        points_P2 = (cells_P2 - np.array(columns_XY.shape) / 2) * voxel_m + center_3[:2]
    else:
        points_P2 = _grid(center_3[:2], size_3[:2], voxel_m)
    return Footprint(center_2=center_3[:2], points_P2=points_P2, cell_m=voxel_m)


def sample(
    footprints: list[Footprint], rod: Rod, cfg: Push, rng: np.random.Generator
) -> tuple[Proposals, NDArray[np.int64]]:
    """``cfg.candidates`` pushes (fewer when free starts are rare) and which object (S) each one is beside.

    Object and heading are uniform. Raises NoFreeStart when none of the draws has a free start.
    """
    drawn = cfg.candidates * cfg.attempts
    object_i = rng.integers(len(footprints), size=drawn)
    heading = rng.uniform(-np.pi, np.pi, size=drawn)
    aim = rng.uniform(-cfg.aim, cfg.aim, size=drawn)
    gap = rng.uniform(*cfg.clearance_m, size=drawn) + rod.radius_m
    choices = zip(object_i, heading, aim, gap, strict=True)
    start_S2 = np.stack([_beside(footprints[i], h, a, g) for i, h, a, g in choices])
    actions_SH3 = _actions(heading, cfg, rng)
    path_SH2 = np.concatenate([start_S2[:, None], start_S2[:, None] + actions_SH3[..., :2].cumsum(axis=1)], axis=1)
    is_free = (np.abs(path_SH2) <= rod.reach_m).all(axis=(1, 2)) & _is_clear(start_S2, footprints, rod, cfg)
    kept = np.flatnonzero(is_free)[: cfg.candidates]
    if not len(kept):
        raise NoFreeStart(f"none of {drawn} starts beside {len(footprints)} objects is free")
    tip_S3 = np.column_stack([start_S2[kept], np.full(len(kept), rod.tip_height_m)])
    return Proposals(*(torch.from_numpy(a).float() for a in (tip_S3, actions_SH3[kept]))), object_i[kept]


def _actions(heading_S: Floats, cfg: Push, rng: np.random.Generator) -> Floats:
    """Horizontal displacements SH3: the first along the heading, each further one turned from the one before."""
    shape = (len(heading_S), cfg.horizon_steps)
    turn = np.radians(rng.uniform(-cfg.turn_deg, cfg.turn_deg, size=shape))
    turn[:, 0] = 0.0
    angle = heading_S[:, None] + np.cumsum(turn, axis=1)
    length = rng.uniform(*cfg.length_m, size=shape)
    return np.stack([length * np.cos(angle), length * np.sin(angle), np.zeros(shape)], axis=-1)


def _beside(shape: Footprint, heading: float, aim: float, gap: float) -> Floats:
    """Where a rod that comes along ``heading`` stands when its axis is ``gap`` away from the first cell it would meet.

    Its line passes the footprint's middle at ``aim`` times half the footprint's width. ``gap`` includes the radius.
    """
    forward = np.array([np.cos(heading), np.sin(heading)])
    side = np.array([-forward[1], forward[0]])
    offset_P2 = shape.points_P2 - shape.center_2
    along, across = offset_P2 @ forward, offset_P2 @ side
    line = aim * (float(np.ptp(across)) + shape.cell_m) / 2 + (across.max() + across.min()) / 2
    reach = gap + shape.cell_m / 2
    apart = np.abs(across - line)
    met = apart < reach
    stop = (along[met] - np.sqrt(reach**2 - apart[met] ** 2)).min(initial=0.0)
    start: Floats = shape.center_2 + line * side + stop * forward
    return start


def _is_clear(start_S2: Floats, footprints: list[Footprint], rod: Rod, cfg: Push) -> NDArray[np.bool_]:
    """Starts where the rod keeps at least the smallest clearance from every cell of every object."""
    clear = np.ones(len(start_S2), dtype=bool)
    for shape in footprints:
        gap_S = np.linalg.norm(start_S2[:, None] - shape.points_P2, axis=-1).min(axis=1) - shape.cell_m / 2
        clear &= gap_S >= rod.radius_m + cfg.clearance_m[0] - 1e-9
    return clear


def _grid(center_2: Floats, size_2: Floats, cell_m: float) -> Floats:
    """Points P2 that fill a rectangle, at most one cell apart."""
    axes = [np.linspace(-s / 2, s / 2, int(np.ceil(s / cell_m)) + 1) for s in size_2]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2) + center_2
