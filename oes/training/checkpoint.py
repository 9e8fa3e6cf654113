"""Settings of a training run and its state on disk: weights, averages, moments, log.

Checkpoints are safetensors files; nothing is unpickled.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import torch
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt
from torch import Tensor, nn

from oes.config import from_json, params, to_json
from oes.training.tensor_io import read_tensors, write_tensors

LogRow = dict[str, float]

STATE_FORMAT = "oes-fit-1"
MUON = "muon"


@params
class TrainConfig:
    """Settings of a training run.

    ``lr`` is the peak of the schedule. ``clip`` bounds the norm of the gradient. ``ema_decay`` of 0
    turns weight averaging off. ``bfloat16`` holds only on devices that compute with it natively.
    """

    steps: PositiveInt
    batch: PositiveInt
    optimizer: Literal["adamw", "muon"]
    lr: PositiveFloat
    warmup_steps: NonNegativeInt
    weight_decay: NonNegativeFloat
    clip: PositiveFloat
    ema_decay: Annotated[float, Field(ge=0, lt=1)]
    bfloat16: bool
    checkpoint_every_steps: PositiveInt
    log_every_steps: PositiveInt
    seed: int


class TrainingError(ValueError):
    """Training cannot continue: a foreign or broken checkpoint, or a loss that is not finite."""


@dataclass
class TrainingState:
    """Everything that training changes, and so the content of a checkpoint."""

    model: nn.Module
    ema: nn.Module | None
    optimizers: list[torch.optim.Optimizer]
    rows: list[LogRow]
    step: int


def save_state(training: TrainingState, path: Path, cfg: TrainConfig) -> None:
    """Write a checkpoint, whole by rename."""
    tensors = {f"model.{name}": value for name, value in training.model.state_dict().items()}
    if training.ema is not None:
        tensors |= {f"ema.{name}": value for name, value in training.ema.state_dict().items()}
    for i, (optimizer, p) in enumerate(_trained(training)):
        tensors |= {f"optimizer.{i}.{name}": value for name, value in optimizer.state[p].items()}
    tensors = {name: value.detach().cpu() for name, value in tensors.items()}
    about = {
        "format": STATE_FORMAT,
        "cfg": to_json(cfg),
        "step": str(training.step),
        "rows": json.dumps(training.rows),
    }
    write_tensors(tensors, path, about)


def restore_state(training: TrainingState, path: Path, cfg: TrainConfig) -> None:
    """Load a checkpoint into ``training``. Raises TrainingError naming the file and its fault."""
    tensors, about = read_tensors(path, STATE_FORMAT, TrainingError)
    if from_json(about["cfg"], TrainConfig, str(path)) != cfg:
        raise TrainingError(f"{path}: written under other settings: {about['cfg']}")
    try:
        training.model.load_state_dict(_under("model.", tensors))
        if training.ema is not None:
            training.ema.load_state_dict(_under("ema.", tensors))
        for i, (optimizer, p) in enumerate(_trained(training)):
            optimizer.state[p] = _moments(_under(f"optimizer.{i}.", tensors), p)
    except (RuntimeError, KeyError) as error:
        raise TrainingError(f"{path}: holds another model: {error}") from error
    training.rows = json.loads(about["rows"])
    training.step = int(about["step"])


def _trained(training: TrainingState) -> list[tuple[torch.optim.Optimizer, Tensor]]:
    """Every trained parameter with its optimizer, in a fixed order."""
    return [
        (each, p)
        for each in training.optimizers
        for group in each.param_groups
        for p in group["params"]
    ]


def _moments(saved: dict[str, Tensor], p: Tensor) -> dict[str, Tensor]:
    # Moments take the parameter's memory layout, else channels-last sums round differently.
    return {
        name: value if name == "step" else torch.empty_like(p, requires_grad=False).copy_(value)
        for name, value in saved.items()
    }


def _under(prefix: str, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    return {
        name.removeprefix(prefix): value
        for name, value in tensors.items()
        if name.startswith(prefix)
    }
