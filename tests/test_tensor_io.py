"""Tensors on disk: the same contents give the same bytes, and come back as they were."""

from pathlib import Path

import torch
from safetensors import safe_open
from safetensors.torch import load_file

from oes.training.tensor_io import write_tensors

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
