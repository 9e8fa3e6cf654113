"""Random shooting, as in the paper (3.3 and C.3): imagine every proposed push, keep the one of least cost.

No elites, no refit: one round of independent samples. ``unroll`` and ``cost`` arrive as functions, so the
planner cannot reach a simulator.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


class PlanError(ValueError):
    """Nothing can be planned: no push to propose, or none with a finite cost."""


@dataclass(frozen=True)
class Proposals:
    """S candidate plans: where the rod starts (``tip_S3``, world) and its H displacements (``actions_SH3``)."""

    tip_S3: Tensor
    actions_SH3: Tensor


@dataclass(frozen=True)
class Plan:
    """The chosen candidate: its start, its actions, the positions it is imagined to reach, and its cost."""

    tip_3: Tensor
    actions_H3: Tensor
    position_HN3: Tensor
    cost: float


def plan(unroll: Callable[[Proposals], Tensor], cost: Callable[[Tensor], Tensor], proposals: Proposals) -> Plan:
    """The best of the proposals. ``unroll`` gives positions SHN3, ``cost`` turns those into S numbers.

    Raises PlanError when no candidate has a finite cost: a diverged model plans nothing.
    """
    samples, horizon, _ = proposals.actions_SH3.shape
    assert proposals.tip_S3.shape == (samples, 3), proposals.tip_S3.shape
    position_SHN3 = unroll(proposals)
    assert position_SHN3.shape == (samples, horizon, position_SHN3.shape[-2], 3), position_SHN3.shape
    cost_S = torch.nan_to_num(cost(position_SHN3), nan=torch.inf)
    best_i = int(cost_S.argmin())
    if not torch.isfinite(cost_S[best_i]):
        raise PlanError(f"plan: none of the {samples} candidates has a finite cost")
    return Plan(
        tip_3=proposals.tip_S3[best_i],
        actions_H3=proposals.actions_SH3[best_i],
        position_HN3=position_SHN3[best_i],
        cost=float(cost_S[best_i]),
    )


def goal_distance(goal_N3: Tensor) -> Callable[[Tensor], Tensor]:
    """Cost of the paper (3.3): mean over objects of the distance in metres from the last position to the goal."""

    def cost(position_SHN3: Tensor) -> Tensor:
        distance_SN: Tensor = torch.linalg.vector_norm(position_SHN3[:, -1] - goal_N3, dim=-1)
        return distance_SN.mean(dim=-1)

    return cost
