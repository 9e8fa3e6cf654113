"""Tensors on disk: safetensors files that appear whole and whose bytes depend on their contents alone."""

import json
import os
from collections.abc import Mapping
from pathlib import Path

from safetensors.torch import save
from torch import Tensor


def write_tensors(tensors: Mapping[str, Tensor], path: Path, about: Mapping[str, str]) -> None:
    """Write named tensors with ``about`` as the file's metadata, whole by rename."""
    part = path.with_name(f"{path.name}.part")
    part.write_bytes(ordered(save({name: value.contiguous() for name, value in tensors.items()}, dict(about))))
    os.replace(part, path)


def ordered(content: bytes) -> bytes:
    """A safetensors file with its header in alphabetical order: the library's own order changes from run to run."""
    length = int.from_bytes(content[:8], "little")
    header = json.dumps(json.loads(content[8 : 8 + length]), sort_keys=True).encode()
    header += b" " * (-len(header) % 8)
    return len(header).to_bytes(8, "little") + header + content[8 + length :]
