"""Clips: what the camera above saw of each training episode, with the pushes, as tensors; and draws
from them.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from oes.baselines.overhead_camera import OverheadView
from oes.config import from_json, to_json
from oes.training.tensor_io import read_tensors, write_tensors

CLIPS_FORMAT = "oes-frames-1"


class ClipsError(ValueError):
    """A frames file that cannot be used; names the file and the reason."""


@dataclass(frozen=True)
class Clips:
    """Pictures BI3HW of I states and, in the coordinates of ``Overhead`` (-1 to 1), the rod BI2 and
    N objects BIN2.

    ``valid_BN`` tells which objects exist. Pictures are bytes on disk and 0 to 1 in batches.
    """

    frame_BI3HW: Tensor
    tip_BI2: Tensor
    object_BIN2: Tensor
    valid_BN: Tensor

    def __len__(self) -> int:
        return len(self.frame_BI3HW)

    def at(self, index: Tensor) -> "Clips":
        """Some of them, pictures as numbers from 0 to 1."""
        picked = {name: value[index] for name, value in vars(self).items()}
        return Clips(**picked | {"frame_BI3HW": picked["frame_BI3HW"].float() / 255})

    def to(self, device: torch.device) -> "Clips":
        """The same on another device."""
        return Clips(**{name: value.to(device) for name, value in vars(self).items()})

    def turned(self, quarter: int, is_mirrored: bool) -> "Clips":
        """Turned by quarters of a circle and mirrored: above a square table all eight are as
        likely.
        """
        frame, tip, objects = self.frame_BI3HW, self.tip_BI2, self.object_BIN2
        if is_mirrored:
            frame, tip, objects = frame.flip(-1), tip * _MIRROR, objects * _MIRROR
        frame = frame.rot90(quarter, (-2, -1))
        for _ in range(quarter % 4):  # rot90 takes what is right (+x) to the top (-y)
            tip, objects = (torch.stack([p[..., 1], -p[..., 0]], -1) for p in (tip, objects))
        return Clips(frame, tip, objects, self.valid_BN)


_MIRROR = torch.tensor([-1.0, 1.0])


def sample_clips(clips: Clips, count: int, rng: np.random.Generator) -> Clips:
    """A batch of random clips, all turned and mirrored the same random way."""
    index = torch.from_numpy(rng.integers(len(clips), size=count))
    return clips.at(index).turned(int(rng.integers(4)), bool(rng.integers(2)))


def write_clips(clips: Clips, view: OverheadView, path: Path) -> None:
    """One safetensors file, whole by rename."""
    write_tensors(vars(clips), path, {"format": CLIPS_FORMAT, "view": to_json(view)})


def read_clips(path: Path) -> tuple[Clips, OverheadView]:
    """What ``write_clips`` wrote. Raises ClipsError."""
    tensors, about = read_tensors(path, CLIPS_FORMAT, ClipsError)
    return Clips(**tensors), from_json(about["view"], OverheadView, f"{path}: view")
