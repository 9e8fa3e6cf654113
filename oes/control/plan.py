"""Planning by imagining: of many proposed plans, the one that costs least (paper 3.3 and C.3).

One round of independent proposals is random shooting, as in the paper; more rounds, each proposed around the best of
the one before, are the cross-entropy method. ``unroll`` and ``cost`` arrive as functions, so the planner cannot reach
a simulator.
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor


class PlanError(ValueError):
    """Nothing can be planned: no push to propose, or none with a finite cost."""


@dataclass(frozen=True)
class Proposals:
    """S candidate plans: where the rod starts (``tip_S3``, world) and its H displacements (``actions_SH3``).

    ``draws_SK`` are the numbers that they were made from, for who proposes plans like the best of these.
    """

    tip_S3: Tensor
    actions_SH3: Tensor
    draws_SK: Tensor


@dataclass(frozen=True)
class Imagined:
    """What S plans would do: the rod's way (I = H + 1 places), where each of N objects gets to and how it turns.

    ``cost_SH``, of a model that judges for itself: metres to the goals, as it sees it. Of a model that draws several
    futures of every plan, S counts them all, draw by draw, and ``draws`` says how many.
    """

    tip_SI3: Tensor
    position_SHN3: Tensor
    turned_SHN33: Tensor
    cost_SH: Tensor | None = None
    draws: int = 1


@dataclass(frozen=True)
class Plan:
    """The chosen candidate up to the step at which it costs least: start, actions, positions imagined, and cost."""

    tip_3: Tensor
    actions_H3: Tensor
    position_HN3: Tensor
    cost: float


Propose = Callable[[Tensor | None], Proposals]  # of the draws EK of the best plans of the round before; None at first
Unroll = Callable[[Proposals], Imagined]
Cost = Callable[[Imagined], Tensor]  # SH: of every plan, were it to end after each of its steps


def risk_averse(cost_FH: Tensor, draws: int, aversion: float) -> Tensor:
    """What plans cost, SH, of which each has ``draws`` futures: the mean and ``aversion`` standard deviations."""
    cost_DSH = cost_FH.reshape(draws, -1, cost_FH.shape[-1])
    if draws == 1:
        return cost_DSH[0]
    mean_SH = cost_DSH.mean(0)
    spread_SH = (cost_DSH - mean_SH).nan_to_num(nan=0.0).square().mean(0).sqrt()
    return mean_SH + aversion * spread_SH


def search(
    propose: Propose, unroll: Unroll, cost: Cost, rounds: int = 1, elites: int = 1, aversion: float = 0.0
) -> Plan:
    """The best plan of ``rounds`` rounds; each after the first is proposed from the ``elites`` best of the last.

    ``aversion``: see ``risk_averse``. Raises PlanError when no candidate has a finite cost: a diverged model plans
    nothing.
    """
    best: Plan | None = None
    drawn: Tensor | None = None
    for _ in range(rounds):
        proposals = propose(drawn)
        imagined = unroll(proposals)
        cost_SH = torch.nan_to_num(risk_averse(cost(imagined), imagined.draws, aversion), nan=torch.inf)
        assert cost_SH.shape == proposals.actions_SH3.shape[:2], cost_SH.shape
        cost_S, stop_S = cost_SH.min(dim=1)
        order = cost_S.argsort()
        if best is None or cost_S[order[0]] < best.cost:
            best = _cut(proposals, imagined, int(order[0]), int(stop_S[order[0]]) + 1, float(cost_S[order[0]]))
        drawn = proposals.draws_SK[order[:elites]]
    if best is None or not torch.isfinite(torch.tensor(best.cost)):
        raise PlanError(f"plan: no candidate has a finite cost in {rounds} rounds")
    return best


def _cut(proposals: Proposals, imagined: Imagined, best_i: int, steps: int, cost: float) -> Plan:
    return Plan(
        tip_3=proposals.tip_S3[best_i],
        actions_H3=proposals.actions_SH3[best_i, :steps],
        position_HN3=imagined.position_SHN3[best_i, :steps],
        cost=cost,
    )
