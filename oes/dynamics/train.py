"""Training a dynamics model: errors of all steps are propagated back through the unroll."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from oes.config import params
from oes.dynamics.augment import Augment, DynamicsBatch, augment
from oes.dynamics.error_model import errors_and_spreads, fit_error_model
from oes.dynamics.examples import Examples
from oes.dynamics.loss import errors, loss_terms
from oes.dynamics.models import NetConfig
from oes.dynamics.unroll import DynamicsModel, Rollout, teacher_forced, unroll
from oes.training.checkpoint import TrainConfig
from oes.training.loop import fit


@params
class Variant:
    """Changes of ``contact``'s training for an ablation.

    ``num_episodes``: training episodes (0: all); ``unroll``: as in ``TaskConfig``; ``augment``:
    whether scenes are augmented; ``gt_surfaces``: ground-truth surfaces as input.
    """

    num_episodes: int
    unroll: bool
    augment: bool
    gt_surfaces: bool


@params
class TaskConfig:
    """Training settings of the models of one task.

    ``observations``: settings of the objects file to train on, for ``random`` cameras and for the
    ``fixed`` one. ``weights``, ``smoothing``: of the loss terms. ``unroll``: back-propagate through
    the unroll, or else train single steps from true states. ``validation_share``: of the training
    episodes. ``voxel_m``: voxel size of the crops. ``fit_overrides``: training of the models that
    do not use ``fit``. ``variants``: of ``contact``, by name.
    """

    observations: dict[str, tuple[str, ...]]
    net: NetConfig
    augment: Augment
    weights: dict[str, float]
    smoothing: float
    unroll: bool
    validation_share: float
    voxel_m: float
    fit: TrainConfig
    fit_overrides: dict[str, TrainConfig]
    variants: dict[str, Variant]


@params
class DynamicsConfig:
    """The section ``dynamics``."""

    pushing: TaskConfig
    falling: TaskConfig

    def of(self, task: str) -> TaskConfig:
        """Settings of a task. Raises ValueError for an unknown task."""
        if task not in (names := [field.name for field in fields(self)]):
            raise ValueError(f"dynamics: unknown task {task!r}; valid: {', '.join(names)}")
        config: TaskConfig = getattr(self, task)
        return config


def train_dynamics(
    model: DynamicsModel, examples: Examples, cfg: TaskConfig, fit_cfg: TrainConfig, work: Path
) -> list[dict[str, float]]:
    """Train in place and calibrate; the log has validation errors (mm, deg)."""
    train_U, validation_U = examples.split(cfg.validation_share)
    validation = examples.batch(validation_U)

    def batch_at(step: int) -> DynamicsBatch:
        # Depends on the step alone: a resumed run sees the same batches.
        generator = torch.Generator().manual_seed(fit_cfg.seed * 1_000_003 + step)
        i_B = torch.randint(len(train_U), (fit_cfg.batch,), generator=generator)
        return augment(examples.batch(train_U[i_B]), cfg.augment, cfg.voxel_m, generator)

    def loss(learner: nn.Module, batch: DynamicsBatch) -> Mapping[str, Tensor]:
        model = cast(DynamicsModel, learner)
        rollout = _unroll(model, batch) if cfg.unroll else teacher_forced(model, batch)
        return loss_terms(rollout, batch, cfg.net.graph.unit_m, cfg.smoothing)

    def validate(learner: nn.Module) -> Mapping[str, float]:
        return errors(_unroll(cast(DynamicsModel, learner), validation), validation)

    rows = fit(model, batch_at, loss, cfg.weights, fit_cfg, work, torch.device("cpu"), validate)
    if model.num_samples > 1:
        calibrate(model, validation)
    return rows


@torch.no_grad()
def calibrate(model: DynamicsModel, validation: DynamicsBatch) -> None:
    """Fit the model's error model to its errors and spreads on held-out scenes."""
    rollout = _unroll(model, validation)
    assert rollout.spread_BTN is not None
    predicted, true = rollout.translation_BTN3, validation.translation_BTN3
    valid_BN = validation.objects.valid_N
    errors_TP, spreads_TP = errors_and_spreads(predicted, true, rollout.spread_BTN, valid_BN)
    model.error_model = fit_error_model(errors_TP, spreads_TP)


def _unroll(model: DynamicsModel, batch: DynamicsBatch) -> Rollout:
    return unroll(model, batch.objects, batch.tip_B3, batch.actions_BT3)
