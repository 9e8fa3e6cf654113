"""Muon (Jordan et al. 2024): updates along the orthogonal matrix nearest to the momentum.

All directions of a weight matrix then learn at the same rate. torch.optim.Muon takes matrices only
and computes in bfloat16, which is slow on processors without it. Here convolution kernels are
matrices too (output channels x the rest), in float32.
"""

from collections.abc import Callable, Iterable

import torch
from torch import Tensor

MOMENTUM = 0.95
ITERATIONS = 5
# Newton-Schulz polynomial: five iterations bring all singular values to between 0.7 and 1.2.
QUINTIC = (3.4445, -4.7750, 2.0315)
# RMS of an update's entries. It is AdamW's usual one, so that one lr suits both (Liu et al. 2025).
ADAM_RMS = 0.2


class Muon(torch.optim.Optimizer):
    """Optimizer of weights with two or more dimensions, with AdamW's decoupled weight decay."""

    def __init__(self, weights: Iterable[Tensor], lr: float, weight_decay: float) -> None:
        super().__init__(weights, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> None:  # type: ignore[override]
        """One update of all weights that have a gradient."""
        assert closure is None, "no closures"
        for group in self.param_groups:
            for p in group["params"]:
                if p.grad is None:
                    continue
                if not self.state[p]:
                    self.state[p]["momentum"] = torch.zeros_like(p)
                momentum = self.state[p]["momentum"]
                momentum.lerp_(p.grad, 1 - MOMENTUM)
                # Nesterov momentum
                ahead = p.grad.lerp(momentum, MOMENTUM)
                matrix = orthogonal(ahead.flatten(1))
                p.mul_(1 - group["lr"] * group["weight_decay"])
                p.add_(matrix.view_as(p), alpha=-group["lr"] * ADAM_RMS * max(matrix.shape) ** 0.5)


def orthogonal(matrix: Tensor) -> Tensor:
    """Nearly the nearest orthogonal matrix: the same singular vectors, singular values near 1."""
    a, b, c = QUINTIC
    is_tall = matrix.shape[0] > matrix.shape[1]
    x: Tensor = matrix.mT if is_tall else matrix
    x = x / x.norm().clamp(min=1e-7)
    for _ in range(ITERATIONS):
        gram = x @ x.mT
        x = a * x + (b * gram + c * gram @ gram) @ x
    return x.mT if is_tall else x
