"""The training loop of all networks: AdamW or Muon, warm-up and cosine schedule, weight averaging.

A step depends on its index, the config and the weights alone (batch, learning rate, random
numbers). A run that is killed at any moment and started again therefore ends in the same weights,
bit for bit, as an uninterrupted one.
"""

import copy
import logging
import math
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor, nn

from oes.progress import progress_bar
from oes.training import checkpoint
from oes.training.checkpoint import LogRow, TrainConfig, TrainingError, TrainingState
from oes.training.muon import Muon
from oes.training.precision import half_precision

__all__ = ["TrainConfig", "TrainingError", "fit", "learning_rate"]

AnyBatch = TypeVar("AnyBatch")
Loss = Callable[[nn.Module, AnyBatch], Mapping[str, Tensor]]
Validate = Callable[[nn.Module], Mapping[str, float]]

log = logging.getLogger(__name__)

WARM_EMA_STEPS = 10


def fit(
    model: nn.Module,
    batch_at: Callable[[int], AnyBatch],
    loss: Loss[AnyBatch],
    weights: Mapping[str, float],
    cfg: TrainConfig,
    work: Path,
    device: torch.device,
    validate: Validate | None = None,
) -> list[LogRow]:
    """Train ``model`` in place and return its log.

    ``batch_at(step)`` runs in a background thread, one batch ahead. It must depend on ``step``
    alone and use a generator of its own. ``loss(model, batch)`` returns named scalar terms on
    ``device``, which are summed with ``weights`` (the same names); it may draw from torch's global
    generator. ``validate(model)`` runs without gradients at every checkpoint and its metrics join
    the log. Validation and the caller get the averaged weights if ``cfg.ema_decay`` > 0. Muon
    trains the matrices; AdamW trains the rest and the modules listed in ``model.outputs``.

    The log has a row every ``log_every_steps`` and at every checkpoint: ``step``, ``lr``, ``loss``
    and every term, averaged since the last row. ``work/checkpoint.safetensors`` keeps the state.
    Raises TrainingError.
    """
    training = _begin(model.to(device), cfg)
    path = work / "checkpoint.safetensors"
    if path.exists():
        checkpoint.restore_state(training, path, cfg)
        log.info("resuming from step %d of %d", training.step, cfg.steps)
    names = list(weights)
    weights_L = torch.tensor([weights[name] for name in names], device=device)
    sums_L = torch.zeros(len(names), dtype=torch.float64)
    model.train()
    batches = _prefetched(batch_at, training.step, cfg.steps)
    with progress_bar(
        batches, total=cfg.steps, initial=training.step, desc="training", unit="step"
    ) as bar:
        for batch in bar:
            sums_L += _step(training, batch, loss, names, weights_L, cfg)
            is_saved = training.step % cfg.checkpoint_every_steps == 0 or training.step == cfg.steps
            if is_saved or training.step % cfg.log_every_steps == 0:
                training.rows.append(_row(training, sums_L, names, weights_L, cfg))
                sums_L.zero_()
                bar.set_postfix_str(_shown(training.rows[-1]), refresh=False)
            if is_saved:
                if validate is not None:
                    _validate(training, validate)
                checkpoint.save_state(training, path, cfg)
    if training.ema is not None:
        model.load_state_dict(training.ema.state_dict())
    model.eval()
    return training.rows


def _begin(model: nn.Module, cfg: TrainConfig) -> TrainingState:
    ema = copy.deepcopy(model).eval().requires_grad_(False) if cfg.ema_decay > 0 else None
    trained = [p for p in model.parameters() if p.requires_grad]
    weights, rest = [p for p in trained if p.ndim >= 2], [p for p in trained if p.ndim < 2]
    inner: list[nn.Parameter] = []
    if cfg.optimizer == checkpoint.MUON:
        last = {id(p) for module in getattr(model, "outputs", ()) for p in module.parameters()}
        inner = [p for p in weights if id(p) not in last]
        weights = [p for p in weights if id(p) in last]
    groups = [
        {"params": weights, "weight_decay": cfg.weight_decay},
        {"params": rest, "weight_decay": 0.0},
    ]
    optimizers: list[torch.optim.Optimizer] = [torch.optim.AdamW(groups, lr=cfg.lr)]
    if inner:
        optimizers.append(Muon(inner, cfg.lr, cfg.weight_decay))
    return TrainingState(model, ema, optimizers, [], 0)


def _step(
    training: TrainingState,
    batch: AnyBatch,
    loss: Loss[AnyBatch],
    names: list[str],
    weights_L: Tensor,
    cfg: TrainConfig,
) -> Tensor:
    """One update; returns the L loss terms."""
    # Seeded by the step, so that a resumed run draws the same numbers.
    torch.manual_seed(cfg.seed * 1_000_003 + training.step)
    for optimizer in training.optimizers:
        for group in optimizer.param_groups:
            group["lr"] = learning_rate(training.step, cfg)
    with half_precision(weights_L.device, cfg.bfloat16):
        terms = loss(training.model, batch)
    assert set(terms) == set(names), (
        f"loss terms {sorted(terms)} are not the weights' {sorted(names)}"
    )
    terms_L = torch.stack([terms[name].float() for name in names])
    training.model.zero_grad(set_to_none=True)
    (terms_L @ weights_L).backward()  # type: ignore[no-untyped-call]
    nn.utils.clip_grad_norm_(training.model.parameters(), cfg.clip)
    for optimizer in training.optimizers:
        optimizer.step()
    training.step += 1
    if training.ema is not None:
        # Early averages forget faster: the first weights are far from the last.
        decay = min(cfg.ema_decay, training.step / (training.step + WARM_EMA_STEPS))
        _average(training.ema, training.model, decay)
    return terms_L.detach().double().cpu()


def learning_rate(step: int, cfg: TrainConfig) -> float:
    """Linear warm-up over ``warmup_steps``, then half a cosine from ``lr`` down to ``lr / 100``."""
    if step < cfg.warmup_steps:
        return cfg.lr * (step + 1) / (cfg.warmup_steps + 1)
    done = (step - cfg.warmup_steps) / max(1, cfg.steps - cfg.warmup_steps)
    return cfg.lr * (0.01 + 0.99 * (1 + math.cos(math.pi * done)) / 2)


@torch.no_grad()
def _average(ema: nn.Module, model: nn.Module, decay: float) -> None:
    """ema = decay * ema + (1 - decay) * model; integer buffers (counters) are copied."""
    for old, new in zip(ema.state_dict().values(), model.state_dict().values(), strict=True):
        if old.is_floating_point():
            old.lerp_(new, 1 - decay)
        else:
            old.copy_(new)


def _prefetched(batch_at: Callable[[int], AnyBatch], start: int, stop: int) -> Iterator[AnyBatch]:
    """Batches of the steps start..stop-1; a thread makes the next one during a step."""
    with ThreadPoolExecutor(1, thread_name_prefix="batch") as pool:
        coming = pool.submit(batch_at, start) if start < stop else None
        for step in range(start, stop):
            assert coming is not None
            batch = coming.result()
            coming = pool.submit(batch_at, step + 1) if step + 1 < stop else None
            yield batch


def _row(
    training: TrainingState, sums_L: Tensor, names: list[str], weights_L: Tensor, cfg: TrainConfig
) -> LogRow:
    last = int(training.rows[-1]["step"]) if training.rows else 0
    means_L = sums_L / (training.step - last)
    terms = dict(zip(names, means_L.tolist(), strict=True))
    bad = [name for name, value in terms.items() if not math.isfinite(value)]
    if bad:
        raise TrainingError(
            f"the loss is not finite by step {training.step}: {', '.join(bad)}; a lower lr may help"
        )
    total = float(means_L @ weights_L.double().cpu())
    return {
        "step": training.step,
        "lr": learning_rate(training.step - 1, cfg),
        "loss": total,
    } | terms


@torch.no_grad()
def _validate(training: TrainingState, validate: Validate) -> None:
    metrics = validate((training.ema or training.model).eval())
    training.model.train()
    training.rows[-1] |= metrics
    log.info("step %d: %s", training.step, _shown(dict(metrics)))


def _shown(row: LogRow) -> str:
    return " ".join(f"{name} {value:.4g}" for name, value in row.items() if name != "step")
