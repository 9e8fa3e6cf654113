"""Candidate pushes: which object, heading, lateral offset, standoff, then turns and lengths."""

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.episode import Bools, Floats
from oes.mpc.scene import Footprint, PlanningScene
from oes.mpc.search import Candidates, PlanError


@params
class PushConfig:
    """Bounds of the sampled pushes.

    ``oversampling``: parameter vectors drawn per candidate, as many are infeasible.
    ``length_m``: range of each action's length.
    ``clearance_m``: range of the initial gap between rod and object.
    ``max_offset``: lateral offset of the push line from the object's middle, as a fraction of half
    the object's width.
    ``max_turn_deg``: change of direction between consecutive actions.
    """

    oversampling: int
    length_m: tuple[float, float]
    clearance_m: tuple[float, float]
    max_offset: float
    max_turn_deg: float


@params
class PlannerConfig:
    """Random shooting (``iterations`` = 1) or the cross-entropy method.

    ``num_candidates``: plans per iteration, of ``horizon_steps`` actions each.
    ``num_elites``: plans around which the next iteration samples.
    ``goal_bias``: share of first-iteration pushes that head for the goal.
    ``heading_std_deg``: std of headings around the goal direction or an elite.
    ``relative_std``: std of the other parameters around an elite, as a fraction of half their
    range.
    ``num_reranked``, ``num_samples``: see ``RiskConfig``; used by stochastic models only, and off
    at ``num_samples`` = 1.
    """

    num_candidates: int
    horizon_steps: int
    iterations: int
    num_elites: int
    goal_bias: float
    heading_std_deg: float
    relative_std: float
    num_reranked: int
    num_samples: int

    def __post_init__(self) -> None:
        """Raises ValueError for fewer reranked plans than elites."""
        reranked, elites = self.num_reranked, self.num_elites
        if reranked < elites:
            raise ValueError(
                f"num_reranked must be at least num_elites ({elites}); found {reranked}"
            )


class NoFreeStart(PlanError):
    """No sampled start of the rod is collision-free."""


class PushSampler:
    """Samples plans whose first action pushes one of the objects to be moved.

    The rod starts free of these and of the obstacles.
    """

    def __init__(self, scene: PlanningScene, push: PushConfig, rng: np.random.Generator) -> None:
        self.scene, self.rod, self.push, self.rng = scene, scene.rod, push, rng

    def __call__(
        self, cfg: PlannerConfig, headings_G: Floats, elites_SC: Tensor | None
    ) -> Candidates:
        """Up to ``cfg.num_candidates`` feasible plans, uniform or around ``elites_SC``.

        ``headings_G``: initial direction (rad) of each object's path to its goal. Raises
        NoFreeStart when no sample is feasible.
        """
        if elites_SC is None:
            params_SC = self._sample_uniform(cfg, headings_G)
        else:
            params_SC = self._sample_around(cfg, elites_SC.numpy())
        steps, moved = cfg.horizon_steps, self.scene.moved
        start_S2 = np.stack([_start(moved[int(i)], *push) for i, *push in params_SC[:, :4]])
        turn_ST, length_ST = params_SC[:, 4 : 4 + steps], params_SC[:, 4 + steps :]
        angle_ST = params_SC[:, 1:2] + np.cumsum(turn_ST, axis=1)
        x_ST, y_ST = length_ST * np.cos(angle_ST), length_ST * np.sin(angle_ST)
        actions_ST3 = np.stack([x_ST, y_ST, np.zeros_like(angle_ST)], axis=-1)
        # Only the start and the first action must stay in the workspace: the cost handles the rest.
        first_end_S2 = start_S2 + actions_ST3[:, 0, :2]
        path_SI2 = np.stack([start_S2, first_end_S2], axis=1)
        is_reached_S = (np.abs(path_SI2) <= self.rod.workspace_m).all(axis=(1, 2))
        kept = np.flatnonzero(is_reached_S & self._is_free(start_S2))[: cfg.num_candidates]
        if not len(kept):
            count = len(params_SC)
            raise NoFreeStart(f"none of {count} starts beside {len(moved)} objects is free")
        tips = np.column_stack([start_S2[kept], np.full(len(kept), self.rod.tip_height_m)])
        tip_S3, actions = (torch.from_numpy(a).float() for a in (tips, actions_ST3[kept]))
        return Candidates(tip_S3, actions, torch.from_numpy(params_SC[kept]))

    def _sample_uniform(self, cfg: PlannerConfig, headings_G: Floats) -> Floats:
        """Parameters SC: object index, heading, lateral offset, standoff, T turns, T lengths."""
        count, rng = cfg.num_candidates * self.push.oversampling, self.rng
        object_i = rng.integers(len(self.scene.moved), size=count)
        heading = rng.uniform(-np.pi, np.pi, size=count)
        is_biased = rng.uniform(size=count) < cfg.goal_bias
        goal_heading = headings_G[object_i]
        goal_heading = goal_heading + np.radians(cfg.heading_std_deg) * rng.normal(size=count)
        low, high = self._bounds(cfg.horizon_steps)
        others_SC = rng.uniform(low, high, size=(count, len(low)))
        return np.column_stack([object_i, np.where(is_biased, goal_heading, heading), others_SC])

    def _sample_around(self, cfg: PlannerConfig, elites_SC: Floats) -> Floats:
        """The elites, then Gaussian perturbations of random elites."""
        count = cfg.num_candidates * self.push.oversampling
        params_SC = elites_SC[self.rng.integers(len(elites_SC), size=count)]
        low, high = self._bounds(cfg.horizon_steps)
        params_SC[:, 1] += np.radians(cfg.heading_std_deg) * self.rng.normal(size=count)
        std = cfg.relative_std * (high - low) / 2
        noise = std * self.rng.normal(size=(count, len(low)))
        params_SC[:, 2:] = (params_SC[:, 2:] + noise).clip(low, high)
        # The elites come first, so the filter for feasible plans never drops them.
        return np.concatenate([elites_SC, params_SC])

    def _bounds(self, steps: int) -> Floats:
        """Lower and upper bounds 2C of offset, standoff, turns and lengths."""
        push, turn = self.push, np.radians(self.push.max_turn_deg)
        standoff = np.array(push.clearance_m) + self.rod.radius_m
        # The first action follows the heading, so its turn is 0.
        turns = [(0.0, 0.0), *[(-turn, turn)] * (steps - 1)]
        offset = (-push.max_offset, push.max_offset)
        return np.array([offset, standoff, *turns, *[push.length_m] * steps]).T

    def _is_free(self, start_S2: Floats) -> Bools:
        """Starts at least the smallest clearance away from every cell of every object."""
        is_free_S = np.ones(len(start_S2), dtype=bool)
        limit_m = self.rod.radius_m + self.push.clearance_m[0] - 1e-9
        for shape in (*self.scene.moved, *self.scene.obstacles):
            distance_SP = np.linalg.norm(start_S2[:, None] - shape.points_P2, axis=-1)
            is_free_S &= distance_SP.min(axis=1) - shape.cell_m / 2 >= limit_m
        return is_free_S


def _start(shape: Footprint, heading: float, offset: float, standoff: float) -> Floats:
    """Position of the rod's axis ``standoff`` before its first contact along ``heading``.

    The push line passes the footprint's middle at ``offset`` times half its width. ``standoff``
    (metres) includes the rod's radius.
    """
    forward = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    cell_P2 = shape.points_P2 - shape.center_2
    along_P, across_P = cell_P2 @ forward, cell_P2 @ left
    width = float(np.ptp(across_P)) + shape.cell_m
    line = offset * width / 2 + (across_P.max() + across_P.min()) / 2
    # Each cell counts as a disc: the rod stops where the first disc is ``reach`` from its axis.
    reach = standoff + shape.cell_m / 2
    distance_P = np.abs(across_P - line)
    is_hit_P = distance_P < reach
    stops = along_P[is_hit_P] - np.sqrt(reach**2 - distance_P[is_hit_P] ** 2)
    start: Floats = shape.center_2 + line * left + stops.min(initial=0.0) * forward
    return start
