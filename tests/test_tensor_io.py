"""Tensors on disk: the same contents give the same bytes, and come back as they were."""

from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from oes.training.compact_weights import WeightsError, write_compact
from oes.training.tensor_io import read_tensors, write_tensors

TENSORS = {f"layer.{i}": torch.arange(i + 3, dtype=torch.float32).reshape(1, -1) for i in range(5)}


def test_the_order_of_names_and_metadata_leaves_no_trace(tmp_path: Path) -> None:
    about = {f"key{i}": str(i) for i in range(12)}
    write_tensors(TENSORS, tmp_path / "a.safetensors", about)
    write_tensors(
        dict(reversed(TENSORS.items())), tmp_path / "b.safetensors", dict(reversed(about.items()))
    )
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


def test_tensors_and_metadata_come_back(tmp_path: Path) -> None:
    path = tmp_path / "w.safetensors"
    write_tensors(TENSORS | {"strided": torch.ones(4, 6)[:, ::2]}, path, {"format": "x"})
    back = load_file(path)
    assert all(torch.equal(back[name], value) for name, value in TENSORS.items())
    assert back["strided"].shape == (4, 3)
    with safe_open(path, framework="pt") as file:
        assert file.metadata() == {"format": "x"}
    assert [p.name for p in tmp_path.iterdir()] == ["w.safetensors"]


def test_compact_weights_come_back_nearly_and_take_a_third_of_the_bytes(tmp_path: Path) -> None:
    torch.manual_seed(0)
    spread = torch.logspace(-3, 1, 64)[:, None, None, None, None]
    tensors = {
        "conv.weight": torch.randn(64, 33, 3, 3, 3) * spread,
        "zero.weight": torch.zeros(50, 1000),
        "map": torch.randn(8, 8),
        "steps": torch.tensor([70000]),
    }
    write_tensors(tensors, tmp_path / "a.safetensors", {"format": "x"})
    write_compact(tmp_path / "a.safetensors", tmp_path / "small" / "a.safetensors")
    back, about = read_tensors(tmp_path / "small" / "a.safetensors", "x", ValueError)
    assert about == {"format": "x"} and back.keys() == tensors.keys()
    assert torch.equal(back["steps"], tensors["steps"])
    assert torch.equal(back["zero.weight"], tensors["zero.weight"])
    torch.testing.assert_close(back["map"].float(), tensors["map"], atol=1e-3, rtol=1e-3)
    blocks = tensors["conv.weight"].flatten().reshape(-1, 32)
    error = (back["conv.weight"] - tensors["conv.weight"]).flatten().reshape(-1, 32)
    assert (error.abs() <= 0.51 * blocks.abs().amax(1, keepdim=True) / 127 + 1e-6).all()
    sizes = [(tmp_path / name).stat().st_size for name in ("small/a.safetensors", "a.safetensors")]
    assert sizes[0] < sizes[1] / 3


def test_weights_beyond_half_precision_are_refused(tmp_path: Path) -> None:
    write_tensors({"big": torch.tensor([1e6])}, tmp_path / "a.safetensors", {"format": "x"})
    with pytest.raises(WeightsError, match=r"a\.safetensors: does not fit half precision: big"):
        write_compact(tmp_path / "a.safetensors", tmp_path / "b.safetensors")
    (tmp_path / "c.safetensors").write_bytes(b"junk")
    with pytest.raises(WeightsError, match=r"c\.safetensors: not a readable safetensors file"):
        write_compact(tmp_path / "c.safetensors", tmp_path / "b.safetensors")
    assert not (tmp_path / "b.safetensors").exists()
