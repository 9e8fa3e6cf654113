"""Training a dynamics model through its unroll: the errors of every step are propagated back through time."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from oes.checkpoint import Fit
from oes.config import params
from oes.dynamics.augment import Augment, Batch, augment
from oes.dynamics.examples import Examples
from oes.dynamics.loss import errors, loss_terms
from oes.dynamics.models import Net
from oes.dynamics.unroll import Model, unroll
from oes.fit import fit


@params
class Dynamics:
    """One task's models: settings of the objects file that they learn from, network, data and training.

    ``draws`` lists the settings of each kind of views: ``random`` ones, or the ``fixed`` one. ``voxel_m`` is the size
    of the crops' voxels, ``held_out`` the share of training episodes that only validate; ``soft`` see ``loss_terms``.
    """

    draws: dict[str, tuple[str, ...]]
    net: Net
    augment: Augment
    weights: dict[str, float]
    soft: float
    held_out: float
    voxel_m: float
    fit: Fit


@params
class Tasks:
    """The section ``dynamics``."""

    pushing: Dynamics
    falling: Dynamics

    def of(self, task: str) -> Dynamics:
        """A task's settings. Raises ValueError for an unknown task."""
        if task not in (names := [field.name for field in fields(self)]):
            raise ValueError(f"dynamics: unknown task {task!r}; there are: {', '.join(names)}")
        found: Dynamics = getattr(self, task)
        return found


def train(model: Model, examples: Examples, cfg: Dynamics, work: Path) -> list[dict[str, float]]:
    """Train in place; the log's rows carry the errors (mm, deg) on held-out episodes as the run goes."""
    train_D, held_D = examples.split(cfg.held_out)

    def batch_at(step: int) -> Batch:
        generator = torch.Generator().manual_seed(cfg.fit.seed * 1_000_003 + step)
        chosen = torch.randint(len(train_D), (cfg.fit.batch,), generator=generator)
        return augment(examples.batch(train_D[chosen]), cfg.augment, examples.voxel_m, generator)

    def loss(learner: nn.Module, batch: Batch) -> Mapping[str, Tensor]:
        found = unroll(cast(Model, learner), batch.objects, batch.tip_B3, batch.actions_BT3)
        return loss_terms(found, batch, cfg.net.graph.unit_m, cfg.soft)

    def validate(learner: nn.Module) -> Mapping[str, float]:
        held = examples.batch(held_D)
        return errors(unroll(cast(Model, learner), held.objects, held.tip_B3, held.actions_BT3), held)

    return fit(model, batch_at, loss, cfg.weights, cfg.fit, work, torch.device("cpu"), validate)
