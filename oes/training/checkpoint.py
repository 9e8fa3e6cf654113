"""What a training run is made of, and its state on disk: weights, averages, moments, log; nothing
is unpickled.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from oes.config import from_json, params, to_json
from oes.training.tensor_io import read_tensors, write_tensors

LogRow = dict[str, float]

STATE_FORMAT = "oes-fit-1"
OPTIMIZERS = ADAMW, MUON = ("adamw", "muon")


@params
class TrainConfig:
    """How to train. ``lr`` is the peak; it falls to a hundredth. ``ema_decay`` 0 keeps the last
    weights instead.

    ``optimizer``: one of ``OPTIMIZERS``; ``muon`` is for weights of two or more dimensions, the
    rest is AdamW's.
    """

    steps: int
    batch: int
    optimizer: str
    lr: float
    warmup_steps: int
    weight_decay: float
    clip: float
    ema_decay: float
    bfloat16: bool
    checkpoint_every_steps: int
    log_every_steps: int
    seed: int

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from params.yaml) for counts that make no
        sense.
        """
        for name in ("steps", "batch", "checkpoint_every_steps", "log_every_steps", "lr", "clip"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} must be positive")
        if not 0 <= self.ema_decay < 1:
            raise ValueError("ema_decay must be in [0, 1)")
        if self.optimizer not in OPTIMIZERS:
            raise ValueError(
                f"optimizer must be one of {', '.join(OPTIMIZERS)}; found {self.optimizer!r}"
            )


class TrainingError(ValueError):
    """Training that cannot go on: a foreign or broken checkpoint, or a loss that is no longer
    finite.
    """


@dataclass
class TrainingState:
    """Everything that changes while training, and so everything that a checkpoint holds."""

    model: nn.Module
    ema: nn.Module | None
    optimizers: list[torch.optim.Optimizer]
    rows: list[LogRow]
    step: int


def save_state(training: TrainingState, path: Path, cfg: TrainConfig) -> None:
    """Write everything to ``path``, which appears whole."""
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
    """Overwrite ``training`` with what ``save_state`` wrote. Raises TrainingError naming the file and
    what is wrong with it.
    """
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
    """An optimizer's state of one parameter: the moments in the parameter's own layout, the counter
    as it was.
    """
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
