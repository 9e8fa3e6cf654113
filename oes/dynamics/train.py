"""Training a dynamics model through its unroll: the errors of every step are propagated back
through time.
"""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from oes.config import params
from oes.dynamics.augment import Augment, DynamicsBatch, augment
from oes.dynamics.error_model import ErrorModel, errors_and_spreads, fit_error_model
from oes.dynamics.examples import Examples
from oes.dynamics.loss import errors, loss_terms
from oes.dynamics.models import NetConfig
from oes.dynamics.unroll import DynamicsModel, teacher_forced, unroll
from oes.training.checkpoint import TrainConfig
from oes.training.loop import fit


@params
class Variant:
    """The model ``contact`` trained otherwise, for the ablations: episodes to learn from (0: all),
    through the unroll or by single steps from true states, whether scenes are augmented, and
    surfaces the true ones.
    """

    episodes: int
    unroll: bool
    augment: bool
    gt_surfaces: bool


@params
class TaskConfig:
    """One task's models: settings of the objects file that they learn from, network, data and
    training.

    ``draws`` lists the settings of each kind of views: ``random`` ones, or the ``fixed`` one.
    ``voxel_m`` is the size of the crops' voxels, ``held_out`` the share of training episodes that
    only validate; ``soft`` see ``loss_terms``. ``unroll``: whether errors run back through the
    unroll, or every step begins at the true state. ``fits`` are those of the models that are
    trained otherwise than by ``fit``; ``variants`` of ``contact``, by word.
    """

    draws: dict[str, tuple[str, ...]]
    net: NetConfig
    augment: Augment
    weights: dict[str, float]
    soft: float
    unroll: bool
    held_out: float
    voxel_m: float
    fit: TrainConfig
    fits: dict[str, TrainConfig]
    variants: dict[str, Variant]

    def fit_of(self, word: str) -> TrainConfig:
        """How a model is trained: ``fit``, but for those that have one of their own."""
        found: TrainConfig = self.fits.get(word, self.fit)
        return found


@params
class DynamicsConfig:
    """The section ``dynamics``."""

    pushing: TaskConfig
    falling: TaskConfig

    def of(self, task: str) -> TaskConfig:
        """A task's settings. Raises ValueError for an unknown task."""
        if task not in (names := [field.name for field in fields(self)]):
            raise ValueError(f"dynamics: unknown task {task!r}; there are: {', '.join(names)}")
        found: TaskConfig = getattr(self, task)
        return found


def train_dynamics(
    model: DynamicsModel, examples: Examples, cfg: TaskConfig, settings: TrainConfig, work: Path
) -> list[dict[str, float]]:
    """Train in place; the log's rows carry the errors (mm, deg) on held-out episodes as the run
    goes.
    """
    train_D, held_D = examples.split(cfg.held_out)

    def batch_at(step: int) -> DynamicsBatch:
        generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + step)
        chosen = torch.randint(len(train_D), (settings.batch,), generator=generator)
        return augment(examples.batch(train_D[chosen]), cfg.augment, examples.voxel_m, generator)

    def loss(learner: nn.Module, batch: DynamicsBatch) -> Mapping[str, Tensor]:
        run, truth = (
            (unroll, ())
            if cfg.unroll
            else (teacher_forced, (batch.translation_BTN3, batch.rotation_BTN33))
        )
        found = run(
            cast(DynamicsModel, learner), batch.objects, batch.tip_B3, batch.actions_BT3, *truth
        )
        return loss_terms(found, batch, cfg.net.graph.unit_m, cfg.soft)

    def validate(learner: nn.Module) -> Mapping[str, float]:
        held = examples.batch(held_D)
        return errors(
            unroll(cast(DynamicsModel, learner), held.objects, held.tip_B3, held.actions_BT3), held
        )

    rows = fit(model, batch_at, loss, cfg.weights, settings, work, torch.device("cpu"), validate)
    if model.num_samples > 1:
        model.error_model = calibrate(model, examples.batch(held_D))
    return rows


@torch.no_grad()
def calibrate(model: DynamicsModel, held: DynamicsBatch) -> ErrorModel:
    """What a trained model's draws are worth on scenes it has not learned from."""
    found = unroll(model, held.objects, held.tip_B3, held.actions_BT3)
    assert found.spread_BTN is not None
    away = errors_and_spreads(
        found.translation_BTN3, held.translation_BTN3, found.spread_BTN, held.objects.valid_N
    )
    return fit_error_model(*away)
