"""Random shooting and the cross-entropy method over candidate plans (paper 3.3 and C.3).

One iteration of independent candidates is random shooting, as in the paper. With more iterations,
each sampled around the elites of the one before, the search is the cross-entropy method (CEM).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from oes.objects import map_tensors


class PlanError(ValueError):
    """No plan exists: no push can be proposed, or no candidate has a finite cost."""


@dataclass(frozen=True)
class Candidates:
    """S candidate plans: start of the rod's tip (world, metres) and its T displacements (metres).

    ``params_SC`` parametrizes the plans; the sampler of the next iteration perturbs it.
    """

    tip_S3: Tensor
    actions_ST3: Tensor
    params_SC: Tensor


@dataclass(frozen=True)
class Rollouts:
    """Predicted outcome of S candidate plans: the tip's path and the motion of N objects.

    ``position_STN3`` are positions (world, metres), ``rotation_STN33`` rotations since the start.
    ``cost_ST`` (metres) overrides the planner's cost for models that predict their own. With
    ``num_samples`` > 1 every leading dimension is MS, sample-major, instead of S.
    """

    tip_SI3: Tensor
    position_STN3: Tensor
    rotation_STN33: Tensor
    cost_ST: Tensor | None = None
    num_samples: int = 1


@dataclass(frozen=True)
class Plan:
    """The chosen candidate, truncated after its cheapest step, with its predicted positions."""

    tip_3: Tensor
    actions_T3: Tensor
    position_TN3: Tensor
    cost: float


Propose = Callable[[Tensor | None], Candidates]  # takes the last elites' params; None at first
Unroll = Callable[[Candidates, int], Rollouts]  # takes the number of samples of the future
Cost = Callable[[Rollouts], Tensor]  # cost ST of every plan if it stopped after each step


@dataclass(frozen=True)
class RiskConfig:
    """Reranking of the cheapest plans under uncertainty.

    The ``num_reranked`` plans with the lowest nominal costs are unrolled ``num_samples`` times and
    then cost mean + ``risk_weight`` * standard deviation.
    """

    num_reranked: int
    num_samples: int
    risk_weight: float


@dataclass(frozen=True)
class ScoredPlans:
    """S plans with their rollouts, their lowest cost over steps and the step (from 0) it is at."""

    candidates: Candidates
    rollouts: Rollouts
    cost_S: Tensor
    stop_S: Tensor

    def truncated(self, rows: Tensor) -> Candidates:
        """Some candidates, cut after the last of their cheapest steps: later ones are not used."""
        chosen = map_tensors(self.candidates, lambda x: x[rows])
        steps = int(self.stop_S[rows].max()) + 1
        return replace(chosen, actions_ST3=chosen.actions_ST3[:, :steps])

    def plan(self, i: int) -> Plan:
        """Candidate ``i`` up to its cheapest step."""
        steps = int(self.stop_S[i]) + 1
        return Plan(
            tip_3=self.candidates.tip_S3[i],
            actions_T3=self.candidates.actions_ST3[i, :steps],
            position_TN3=self.rollouts.position_STN3[i, :steps],
            cost=float(self.cost_S[i]),
        )


def search(
    propose: Propose,
    unroll: Unroll,
    cost: Cost,
    iterations: int = 1,
    num_elites: int = 1,
    risk: RiskConfig | None = None,
) -> Plan:
    """The cheapest plan over all iterations; raises PlanError when no cost is finite.

    With ``risk``, costs are those after reranking; ``num_reranked`` must be >= ``num_elites``.
    """
    best: Plan | None = None
    elites_SC: Tensor | None = None
    for _ in range(iterations):
        scored = _score(propose(elites_SC), unroll, cost)
        if risk is not None:
            top = scored.cost_S.argsort()[: risk.num_reranked]
            candidates, stop_S = scored.truncated(top), scored.stop_S[top]
            scored = _score(candidates, unroll, cost, risk, stop_S)
        order = scored.cost_S.argsort()[:num_elites]
        if best is None or scored.cost_S[order[0]] < best.cost:
            best = scored.plan(int(order[0]))
        elites_SC = scored.candidates.params_SC[order]
    if best is None or not torch.isfinite(torch.tensor(best.cost)):
        raise PlanError(f"plan: no candidate has a finite cost in {iterations} iterations")
    return best


def _score(
    candidates: Candidates,
    unroll: Unroll,
    cost: Cost,
    risk: RiskConfig | None = None,
    stop_S: Tensor | None = None,
) -> ScoredPlans:
    """Nominal scores, or risk-adjusted ones. Plan i must stop by step ``stop_S[i]`` (from 0)."""
    rollouts = unroll(candidates, risk.num_samples if risk else 1)
    cost_ST = cost(rollouts)
    if risk:
        cost_ST = risk_adjusted(cost_ST, rollouts.num_samples, risk.risk_weight)
    # A diverged model predicts NaN: its plans are never chosen.
    cost_ST = torch.nan_to_num(cost_ST, nan=torch.inf)
    assert cost_ST.shape == candidates.actions_ST3.shape[:2], cost_ST.shape
    if stop_S is not None:
        is_late_ST = torch.arange(cost_ST.shape[1]) > stop_S[:, None]
        cost_ST = cost_ST.masked_fill(is_late_ST, torch.inf)
    return ScoredPlans(candidates, rollouts, *cost_ST.min(dim=1))


def risk_adjusted(cost_ST: Tensor, num_samples: int, risk_weight: float) -> Tensor:
    """Mean + ``risk_weight`` * standard deviation over samples: (MS)T costs become ST."""
    cost_MST = cost_ST.reshape(num_samples, -1, cost_ST.shape[-1])
    if num_samples == 1:
        return cost_MST[0]
    mean_ST = cost_MST.mean(0)
    # inf - inf is NaN: a plan that fails in every sample has no spread, and stays infinite.
    std_ST = (cost_MST - mean_ST).nan_to_num(nan=0.0).square().mean(0).sqrt()
    return mean_ST + risk_weight * std_ST
