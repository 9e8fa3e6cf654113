"""Safetensors files that appear whole, with bytes that depend on their contents alone."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

# An int8 kernel of a compact copy (see ``compact_weights``) comes with a tensor of scales, one for
# each block of its flattened values.
SCALE_SUFFIX = "#scale"
BLOCK_SIZE = 32


def write_tensors(tensors: Mapping[str, Tensor], path: Path, about: Mapping[str, str]) -> None:
    """Write named tensors with ``about`` as the file's metadata, whole by rename."""
    part = path.with_name(f"{path.name}.part")
    contiguous = {name: value.contiguous() for name, value in tensors.items()}
    part.write_bytes(ordered(save(contiguous, dict(about))))
    os.replace(part, path)


def read_tensors(
    path: Path, form: str, error: type[ValueError]
) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and metadata of a file of the format ``form``.

    Raises ``error``, naming the file, if it is missing, unreadable or of another format.
    """
    try:
        with safe_open(path, framework="pt") as file:
            about: dict[str, str] = file.metadata() or {}
            if about.get("format") != form:
                raise error(f"{path}: its format is {about.get('format')!r}, wanted {form!r}")
            return _restored({name: file.get_tensor(name) for name in file.keys()}), about
    except (SafetensorError, OSError) as reason:
        fault = " ".join(str(reason).split())[:200]
        raise error(f"{path}: not a readable safetensors file: {fault}") from reason


def _restored(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """The float32 kernels that a compact copy stores as int8 with scales."""
    for name in [name for name in tensors if name.endswith(SCALE_SUFFIX)]:
        scale = tensors.pop(name).float().repeat_interleave(BLOCK_SIZE)
        kernel = tensors[name.removesuffix(SCALE_SUFFIX)]
        restored = kernel.float().flatten() * scale[: kernel.numel()]
        tensors[name.removesuffix(SCALE_SUFFIX)] = restored.reshape(kernel.shape)
    return tensors


def ordered(content: bytes) -> bytes:
    """A safetensors file with a sorted header; the library's own order changes from run to run."""
    length = int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8 : 8 + length]), sort_keys=True).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + content[8 + length :]
