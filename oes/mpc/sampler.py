"""Pushes worth imagining: an object, a free start beside what is perceived of it, a direction and a
length.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.config import params
from oes.episode import Floats
from oes.mpc.search import Candidates, PlanError


@params
class PushConfig:
    """Which pushes are proposed at all.

    Of ``attempts`` times as many draws as are wanted those are kept that can be made. Each action's
    length is uniform in ``length_m``; the rod starts ``clearance_m`` (range) short of the perceived
    outline on a line that passes the object's middle by up to ``aim`` times half its width; later
    actions turn by up to ``turn_deg``.
    """

    attempts: int
    length_m: tuple[float, float]
    clearance_m: tuple[float, float]
    aim: float
    turn_deg: float


@params
class PlannerConfig:
    """How a planner looks for a push: ``rounds`` times ``candidates`` plans of ``horizon_steps``
    actions.

    One round is random shooting. Each further one is drawn around the ``elites`` best plans of the
    last: headings and turns with a standard deviation of ``spread_deg``, the other numbers of
    ``spread`` times half their range. In the first round a share ``toward`` sets out where an
    object should go, give or take ``spread_deg``. With a model that draws futures, the
    ``shortlist`` best of each round are imagined again, in ``futures`` each (1: never).
    """

    candidates: int
    horizon_steps: int
    rounds: int
    elites: int
    toward: float
    spread_deg: float
    spread: float
    shortlist: int
    futures: int

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from params.yaml) for a shortlist without all
        elites.
        """
        if self.shortlist < self.elites:
            raise ValueError(
                f"shortlist must be at least elites ({self.elites}); found {self.shortlist}"
            )


@dataclass(frozen=True)
class Rod:
    """The pushing rod, a vertical cylinder, in metres: its radius, the height of its tip, and how
    far it may go.

    The tip stays within ``reach_m`` of the table's centre along x and along y.
    """

    radius_m: float
    tip_height_m: float
    reach_m: float


@dataclass(frozen=True)
class Footprint:
    """What the rod must not start in: the perceived object seen from above, as points and the cell
    they stand for.
    """

    center_2: Floats
    points_P2: Floats
    cell_m: float

    @property
    def radius_m(self) -> float:
        """Of the circle about its centre that holds it."""
        return float(np.linalg.norm(self.points_P2 - self.center_2, axis=1).max() + self.cell_m / 2)


class NoFreeStart(PlanError):
    """No point beside any object is free for the rod."""


def object_footprint(
    center_3: Floats,
    size_3: Floats,
    occupancy_XYZ: NDArray[np.float32],
    voxel_m: float,
    threshold: float,
) -> Footprint:
    """Outline of an object from its completed mask, over all heights: the rod is a vertical
    cylinder.

    A mask with no voxel above ``threshold`` (0..1) gives the box instead, sampled at the voxel
    size.
    """
    columns_XY = (occupancy_XYZ > threshold).any(axis=2)
    if columns_XY.any():
        cells_P2 = np.argwhere(columns_XY) + 0.5
        points_P2 = (cells_P2 - np.array(columns_XY.shape) / 2) * voxel_m + center_3[:2]
    else:
        points_P2 = _grid(center_3[:2], size_3[:2], voxel_m)
    return Footprint(center_2=center_3[:2], points_P2=points_P2, cell_m=voxel_m)


class PushSampler:
    """Proposes plans that set out with a push of one of ``shapes``; the rod starts on none of those
    nor ``others``.
    """

    def __init__(
        self,
        shapes: Sequence[Footprint],
        others: Sequence[Footprint],
        rod: Rod,
        push: PushConfig,
        rng: np.random.Generator,
    ) -> None:
        self.shapes, self.others, self.rod, self.push, self.rng = shapes, others, rod, push, rng

    def __call__(
        self, cfg: PlannerConfig, headings_G: Floats, elites_EK: Tensor | None
    ) -> Candidates:
        """``cfg.candidates`` plans (fewer when free starts are rare), new or around ``elites_EK``.

        ``headings_G``: where each of the shapes should go. Raises NoFreeStart when no draw has a
        free start.
        """
        draws_DK = (
            self._fresh(cfg, headings_G)
            if elites_EK is None
            else self._near(cfg, elites_EK.numpy())
        )
        steps = cfg.horizon_steps
        start_D2 = np.stack([_beside(self.shapes[int(i)], *place) for i, *place in draws_DK[:, :4]])
        actions_DH3 = _actions(draws_DK[:, 1], draws_DK[:, 4 : 4 + steps], draws_DK[:, 4 + steps :])
        path_DH2 = np.concatenate(
            [start_D2[:, None], start_D2[:, None] + actions_DH3[..., :2].cumsum(axis=1)], axis=1
        )
        is_reached = (np.abs(path_DH2[:, :2]) <= self.rod.reach_m).all(axis=(1, 2))
        kept = np.flatnonzero(is_reached & self._is_clear(start_D2))[: cfg.candidates]
        if not len(kept):
            raise NoFreeStart(
                f"none of {len(draws_DK)} starts beside {len(self.shapes)} objects is free"
            )
        tips = np.column_stack([start_D2[kept], np.full(len(kept), self.rod.tip_height_m)])
        tip_S3, actions_SH3 = (torch.from_numpy(a).float() for a in (tips, actions_DH3[kept]))
        return Candidates(tip_S3, actions_SH3, torch.from_numpy(draws_DK[kept]))

    def _fresh(self, cfg: PlannerConfig, headings_G: Floats) -> Floats:
        """Draws DK: which object, heading, aim, gap; then the turn before and the length of each
        action.
        """
        count, steps, rng = cfg.candidates * self.push.attempts, cfg.horizon_steps, self.rng
        object_i = rng.integers(len(self.shapes), size=count)
        heading = rng.uniform(-np.pi, np.pi, size=count)
        is_toward = rng.uniform(size=count) < cfg.toward
        toward = headings_G[object_i] + np.radians(cfg.spread_deg) * rng.normal(size=count)
        low, high = self._bounds(steps)
        rest_DK = rng.uniform(low, high, size=(count, len(low)))
        return np.column_stack([object_i, np.where(is_toward, toward, heading), rest_DK])

    def _near(self, cfg: PlannerConfig, elites_EK: Floats) -> Floats:
        """The elites themselves, then draws around them."""
        count = cfg.candidates * self.push.attempts
        draws_DK = elites_EK[self.rng.integers(len(elites_EK), size=count)]
        low, high = self._bounds(cfg.horizon_steps)
        draws_DK[:, 1] += np.radians(cfg.spread_deg) * self.rng.normal(size=count)
        noise = cfg.spread * (high - low) / 2 * self.rng.normal(size=(count, len(low)))
        draws_DK[:, 2:] = (draws_DK[:, 2:] + noise).clip(low, high)
        return np.concatenate([elites_EK, draws_DK])

    def _bounds(self, steps: int) -> Floats:
        """Least and greatest aim, gap, turns and lengths: 2K."""
        push, turn = self.push, np.radians(self.push.turn_deg)
        gap = np.array(push.clearance_m) + self.rod.radius_m
        turns = [(0.0, 0.0), *[(-turn, turn)] * (steps - 1)]
        return np.array([(-push.aim, push.aim), gap, *turns, *[push.length_m] * steps]).T

    def _is_clear(self, start_D2: Floats) -> NDArray[np.bool_]:
        """Starts where the rod keeps at least the smallest clearance from every cell of every
        object.
        """
        clear = np.ones(len(start_D2), dtype=bool)
        for shape in (*self.shapes, *self.others):
            gap_D = (
                np.linalg.norm(start_D2[:, None] - shape.points_P2, axis=-1).min(axis=1)
                - shape.cell_m / 2
            )
            clear &= gap_D >= self.rod.radius_m + self.push.clearance_m[0] - 1e-9
        return clear


def _actions(heading_D: Floats, turn_DH: Floats, length_DH: Floats) -> Floats:
    """Horizontal displacements DH3: the first along the heading, each further one turned from the
    one before.
    """
    angle = heading_D[:, None] + np.cumsum(turn_DH, axis=1)
    return np.stack(
        [length_DH * np.cos(angle), length_DH * np.sin(angle), np.zeros_like(angle)], axis=-1
    )


def _beside(shape: Footprint, heading: float, aim: float, gap: float) -> Floats:
    """Where a rod that comes along ``heading`` stands when its axis is ``gap`` away from the first
    cell it would meet.

    Its line passes the footprint's middle at ``aim`` times half the footprint's width. ``gap``
    includes the radius.
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


def _grid(center_2: Floats, size_2: Floats, cell_m: float) -> Floats:
    """Points P2 that fill a rectangle, at most one cell apart."""
    axes = [np.linspace(-s / 2, s / 2, int(np.ceil(s / cell_m)) + 1) for s in size_2]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2) + center_2
