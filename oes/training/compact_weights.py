"""Small copies of trained weights for git: int8 kernels of 3D convolutions, float16 for the rest.

3D convolutions hold most of the perception weights and tolerate rounding to 8 bits per channel.
Rounding the learned maps and the image decoder as well would cost 0.25 dB of view prediction.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from oes.training.tensor_io import SCALE, ordered

KERNEL_DIMS = 5  # output and input channels, three axes
INT8_MAX = 127

Arrays = dict[str, NDArray[np.generic]]


class WeightsError(ValueError):
    """A weights file that cannot be read or does not fit half precision; the message names it."""


def write_compact(source: Path, target: Path) -> None:
    """Copy a weights file in few bytes, with the same metadata; ``read_tensors`` restores float32.

    Raises WeightsError.
    """
    try:
        with safe_open(source, framework="np") as file:
            about = file.metadata()
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{source}: not a readable safetensors file: {error}") from error
    compact = _compact(tensors)
    if bad := [name for name, value in compact.items() if not np.isfinite(value).all()]:
        raise WeightsError(f"{source}: does not fit half precision: {', '.join(bad)}")
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(ordered(save(compact, about)))


def _compact(tensors: Mapping[str, NDArray[np.generic]]) -> Arrays:
    compact: Arrays = {}
    for name, value in tensors.items():
        if value.dtype != np.float32:
            compact[name] = value
        elif value.ndim == KERNEL_DIMS:
            largest = np.abs(value).max(axis=(1, 2, 3, 4), keepdims=True)
            scale = np.maximum(largest, np.finfo(np.float32).tiny) / INT8_MAX
            compact[name] = np.rint(value / scale).astype(np.int8)
            compact[name + SCALE] = scale.astype(np.float32)
        else:
            with np.errstate(over="ignore"):  # reported as a WeightsError
                compact[name] = value.astype(np.float16)
    return compact
