"""Planning by imagining: of many proposed plans, the one that costs least (paper 3.3 and C.3).

One round of independent proposals is random shooting, as in the paper; more rounds, each proposed
around the best of the one before, are the cross-entropy method. Where a model draws futures, every
plan is imagined in one, and the best of them in many. ``unroll`` and ``cost`` arrive as functions,
so the planner cannot reach a simulator.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor


class PlanError(ValueError):
    """Nothing can be planned: no push to propose, or none with a finite cost."""


@dataclass(frozen=True)
class Candidates:
    """S candidate plans: where the rod starts (``tip_S3``, world) and its H displacements
    (``actions_SH3``).

    ``draws_SK`` are the numbers that they were made from, for who proposes plans like the best of
    these.
    """

    tip_S3: Tensor
    actions_SH3: Tensor
    draws_SK: Tensor


@dataclass(frozen=True)
class Rollouts:
    """What S plans would do: the rod's way (I = H + 1 places), where each of N objects gets to and
    how it turns.

    ``cost_SH``, of a model that judges for itself: metres to the goals, as it sees it. Of a model
    that draws several futures of every plan, S counts them all, draw by draw, and ``draws`` says
    how many.
    """

    tip_SI3: Tensor
    position_SHN3: Tensor
    turned_SHN33: Tensor
    cost_SH: Tensor | None = None
    draws: int = 1


@dataclass(frozen=True)
class Plan:
    """The chosen candidate up to the step at which it costs least: start, actions, positions
    imagined, and cost.
    """

    tip_3: Tensor
    actions_H3: Tensor
    position_HN3: Tensor
    cost: float


Propose = Callable[
    [Tensor | None], Candidates
]  # of the draws EK of the best plans of the round before; None at first
Unroll = Callable[[Candidates, int], Rollouts]  # in so many futures of every plan
Cost = Callable[[Rollouts], Tensor]  # SH: of every plan, were it to end after each of its steps


@dataclass(frozen=True)
class RiskConfig:
    """How plans are judged whose future is uncertain: the ``shortlist`` best by the likeliest are
    imagined in ``futures`` each, and cost the mean and ``aversion`` standard deviations.
    """

    shortlist: int
    futures: int
    aversion: float


@dataclass(frozen=True)
class ScoredPlans:
    """S plans, what they would do, what each costs and after which step (from 0) it costs that."""

    proposals: Candidates
    imagined: Rollouts
    cost_S: Tensor
    stop_S: Tensor

    def best(self, count: int) -> Tensor:
        """Numbers of the ``count`` cheapest, in order."""
        return self.cost_S.argsort()[:count]

    def shortlisted(self, count: int) -> tuple[Candidates, Tensor]:
        """The ``count`` cheapest, no longer than any of them needs, and after which step (from 0)
        each stops.
        """
        best = self.best(count)
        chosen = Candidates(**{name: value[best] for name, value in vars(self.proposals).items()})
        steps = int(self.stop_S[best].max()) + 1
        return replace(chosen, actions_SH3=chosen.actions_SH3[:, :steps]), self.stop_S[best]

    def plan(self, i: int) -> Plan:
        """One of them, up to where it costs least."""
        steps = int(self.stop_S[i]) + 1
        return Plan(
            tip_3=self.proposals.tip_S3[i],
            actions_H3=self.proposals.actions_SH3[i, :steps],
            position_HN3=self.imagined.position_SHN3[i, :steps],
            cost=float(self.cost_S[i]),
        )


def risk_averse(cost_FH: Tensor, draws: int, aversion: float) -> Tensor:
    """What plans cost, SH, of which each has ``draws`` futures: the mean and ``aversion`` standard
    deviations.
    """
    cost_DSH = cost_FH.reshape(draws, -1, cost_FH.shape[-1])
    if draws == 1:
        return cost_DSH[0]
    mean_SH = cost_DSH.mean(0)
    spread_SH = (cost_DSH - mean_SH).nan_to_num(nan=0.0).square().mean(0).sqrt()
    return mean_SH + aversion * spread_SH


def search(
    propose: Propose,
    unroll: Unroll,
    cost: Cost,
    rounds: int = 1,
    elites: int = 1,
    risk: RiskConfig | None = None,
) -> Plan:
    """The best plan of ``rounds`` rounds; each after the first is proposed from the ``elites`` best
    of the last.

    ``risk``: where plans are judged in several futures; its shortlist holds the elites. Raises
    PlanError when no candidate has a finite cost: a diverged model plans nothing.
    """
    best: Plan | None = None
    drawn: Tensor | None = None
    for _ in range(rounds):
        judged = _score(propose(drawn), unroll, cost)
        if risk is not None:
            proposals, stop_S = judged.shortlisted(risk.shortlist)
            judged = _score(proposals, unroll, cost, risk.futures, risk.aversion, stop_S)
        order = judged.best(elites)
        if best is None or judged.cost_S[order[0]] < best.cost:
            best = judged.plan(int(order[0]))
        drawn = judged.proposals.draws_SK[order]
    if best is None or not torch.isfinite(torch.tensor(best.cost)):
        raise PlanError(f"plan: no candidate has a finite cost in {rounds} rounds")
    return best


def _score(
    proposals: Candidates,
    unroll: Unroll,
    cost: Cost,
    futures: int = 1,
    aversion: float = 0.0,
    stop_S: Tensor | None = None,
) -> ScoredPlans:
    """Every plan in so many futures. ``stop_S``: after which step (from 0) each ends at the
    latest.
    """
    imagined = unroll(proposals, futures)
    cost_SH = torch.nan_to_num(risk_averse(cost(imagined), imagined.draws, aversion), nan=torch.inf)
    assert cost_SH.shape == proposals.actions_SH3.shape[:2], cost_SH.shape
    if stop_S is not None:
        cost_SH = cost_SH.masked_fill(torch.arange(cost_SH.shape[1]) > stop_S[:, None], torch.inf)
    return ScoredPlans(proposals, imagined, *cost_SH.min(dim=1))
