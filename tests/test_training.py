"""The training loop: exact resumption, refusals, weight averaging, and that it trains at all."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from oes.training.loop import TrainConfig, TrainingError, fit, learning_rate
from oes.training.muon import orthogonal

CPU = torch.device("cpu")
CFG = {
    "steps": 60, "batch": 16, "optimizer": "adamw", "lr": 1.0e-2, "warmup_steps": 5,
    "weight_decay": 0.01, "clip": 1.0, "ema_decay": 0.9, "bfloat16": False,
    "checkpoint_every_steps": 20, "log_every_steps": 8, "seed": 3,
}  # fmt: skip
WEIGHTS = {"fit": 1.0, "size": 1.0e-3}


class Stopped(Exception):
    pass


def make_model() -> nn.Module:
    torch.manual_seed(0)
    # Channels-last weights and batch norm: the moments' layout and the buffers must survive a
    # checkpoint too.
    conv = nn.Conv2d(2, 4, 3, padding=1)
    conv = conv.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    tail = [nn.BatchNorm2d(4), nn.ReLU(), nn.Dropout(0.2), nn.Flatten(), nn.Linear(64, 1)]
    return nn.Sequential(conv, *tail)


def batch_at(step: int) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(step)
    x = torch.randn(16, 2, 4, 4, generator=generator)
    return x, x.mean((1, 2, 3), keepdim=False)[:, None] * 3 + 1


def loss(model: nn.Module, batch: tuple[Tensor, Tensor]) -> dict[str, Tensor]:
    x, y = batch
    return {
        "fit": (model(x) - y).square().mean(),
        "size": sum(p.square().sum() for p in model.parameters()),
    }


def validate(model: nn.Module) -> dict[str, float]:
    torch.rand(7)  # an evaluation that draws random numbers must not change the training
    return {"val": float(loss(model, batch_at(-1 % 1000))["fit"])}


def train(
    work: Path, stop_at: int | None = None, **changes: float | str
) -> tuple[nn.Module, list[dict[str, float]]]:
    def batches(step: int) -> tuple[Tensor, Tensor]:
        if step == stop_at:
            raise Stopped
        return batch_at(step)

    work.mkdir(exist_ok=True)
    model = make_model()
    rows = fit(model, batches, loss, WEIGHTS, TrainConfig(**(CFG | changes)), work, CPU, validate)
    return model, rows


@pytest.fixture(scope="module")
def unbroken(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[dict[str, Tensor], list[dict[str, float]], Path]:
    work = tmp_path_factory.mktemp("unbroken")
    model, rows = train(work)
    return model.state_dict(), rows, work / "checkpoint.safetensors"


def assert_same(model: nn.Module, rows: list[dict[str, float]], unbroken: tuple) -> None:
    assert rows == unbroken[1]
    for name, value in model.state_dict().items():
        assert torch.equal(value, unbroken[0][name]), name


def test_it_trains_and_logs(unbroken: tuple) -> None:
    rows = unbroken[1]
    assert [row["step"] for row in rows] == [8, 16, 20, 24, 32, 40, 48, 56, 60]
    assert rows[-1]["fit"] < 0.3 * rows[0]["fit"]
    assert rows[0]["loss"] == pytest.approx(rows[0]["fit"] + 1e-3 * rows[0]["size"])
    assert [row["step"] for row in rows if "val" in row] == [20, 40, 60]


@pytest.mark.parametrize("stop_at", [21, 50])
def test_resumed_equals_unbroken(tmp_path: Path, unbroken: tuple, stop_at: int) -> None:
    with pytest.raises(Stopped):
        train(tmp_path, stop_at)
    torch.rand(100)  # the process that goes on has another history
    assert_same(*train(tmp_path), unbroken)
    assert_same(*train(tmp_path), unbroken)  # finished already: nothing is left to do


def test_resumed_equals_unbroken_with_muon(tmp_path: Path) -> None:
    model, rows = train(tmp_path / "whole", optimizer="muon")
    assert rows[-1]["fit"] < 0.3 * rows[0]["fit"]
    with pytest.raises(Stopped):
        train(tmp_path / "parts", 21, optimizer="muon")
    assert_same(*train(tmp_path / "parts", optimizer="muon"), (model.state_dict(), rows))


@pytest.mark.parametrize("shape", [(8, 8), (6, 40), (40, 6)])
def test_muon_steps_are_about_orthogonal(shape: tuple[int, int]) -> None:
    matrix = torch.randn(shape, generator=torch.Generator().manual_seed(0))
    u, _, vh = torch.linalg.svd(matrix, full_matrices=False)
    turned = u.mT @ orthogonal(matrix) @ vh.mT  # in the matrix's own singular vectors
    assert turned.diagonal().min() > 0.5 and turned.diagonal().max() < 1.3
    assert (turned - turned.diagonal().diag()).abs().max() < 1e-4


def test_killed_process_resumes(tmp_path: Path, unbroken: tuple) -> None:
    here = str(Path(__file__).parent)
    code = f"import sys, time; from pathlib import Path; sys.path.insert(0, {here!r})\n"
    code += "import test_training as t\n"
    code += "make = t.batch_at\nt.batch_at = lambda i: (time.sleep(600 * (i == 45)), make(i))[1]\n"
    code += f"t.train(Path({str(tmp_path)!r}))"
    process = subprocess.Popen([sys.executable, "-c", code])
    deadline = time.monotonic() + 30
    while not (tmp_path / "checkpoint.safetensors").exists() and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    assert_same(*train(tmp_path), unbroken)


def test_averaged_weights_are_returned(unbroken: tuple) -> None:
    saved = load_file(unbroken[2])
    name = "5.weight"
    assert torch.equal(saved[f"ema.{name}"], unbroken[0][name])
    assert not torch.equal(saved[f"model.{name}"], unbroken[0][name])


def test_without_averaging_and_in_bfloat16(tmp_path: Path) -> None:
    model, rows = train(tmp_path, ema_decay=0.0, bfloat16=True)
    saved = load_file(tmp_path / "checkpoint.safetensors")
    assert not any(name.startswith("ema.") for name in saved)
    assert torch.equal(saved["model.5.weight"], model.state_dict()["5.weight"])
    assert rows[-1]["fit"] < 0.3 * rows[0]["fit"]


def test_bad_checkpoints_are_refused_by_name(tmp_path: Path, unbroken: tuple) -> None:
    path = tmp_path / "checkpoint.safetensors"
    path.write_bytes(b"\x80\x04not safetensors at all")
    with pytest.raises(
        TrainingError, match=r"checkpoint\.safetensors: not a readable safetensors file"
    ):
        train(tmp_path)
    path.write_bytes(unbroken[2].read_bytes()[:-100])
    with pytest.raises(
        TrainingError, match=r"checkpoint\.safetensors: not a readable safetensors file"
    ):
        train(tmp_path)
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(TrainingError, match=r"checkpoint\.safetensors: its format is"):
        train(tmp_path)
    shutil.copy(unbroken[2], path)
    with pytest.raises(
        TrainingError, match=r"checkpoint\.safetensors: written under other settings"
    ):
        train(tmp_path, lr=0.5)
    with pytest.raises(TrainingError, match=r"checkpoint\.safetensors: holds another model"):
        fit(nn.Linear(2, 2), batch_at, loss, WEIGHTS, TrainConfig(**CFG), tmp_path, CPU)


def test_diverged_loss_is_named(tmp_path: Path) -> None:
    def broken(model: nn.Module, batch: tuple[Tensor, Tensor]) -> dict[str, Tensor]:
        return loss(model, batch) | {"size": torch.tensor(torch.nan)}

    with pytest.raises(TrainingError, match="step 8: size"):
        fit(make_model(), batch_at, broken, WEIGHTS, TrainConfig(**CFG), tmp_path, CPU)
    assert not list(tmp_path.iterdir())


def test_terms_must_be_the_weights(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="extra"):
        fit(
            make_model(),
            batch_at,
            loss,
            WEIGHTS | {"extra": 1.0},
            TrainConfig(**CFG),
            tmp_path,
            CPU,
        )


def test_learning_rate_rises_and_falls_to_a_hundredth() -> None:
    rates = [learning_rate(step, TrainConfig(**CFG)) for step in range(61)]
    assert max(rates) == rates[5] == 0.01
    assert rates[60] == pytest.approx(0.0001)
    assert rates == sorted(rates[:6]) + sorted(rates[6:], reverse=True)


@pytest.mark.parametrize(
    "change",
    [{"steps": 0}, {"clip": 0.0}, {"ema_decay": 1.0}, {"lr": "1e-3"}, {"optimizer": "sgd"}],
)
def test_senseless_settings_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(change))):
        TrainConfig(**(CFG | change))
