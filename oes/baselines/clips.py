"""Clips: overhead images of whole episodes with the rod's path, and random batches of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from oes.baselines.overhead_camera import OverheadView
from oes.config import from_json, to_json
from oes.training.tensor_io import read_tensors, write_tensors

CLIPS_FILE = "clips.safetensors"
CLIPS_FORMAT = "oes-clips-1"
_MIRROR = torch.tensor([-1.0, 1.0])


class ClipsError(ValueError):
    """A clips file that cannot be used; names the file and the reason."""


@dataclass(frozen=True)
class Clips:
    """B clips of I states: images, rod tips and object centres in normalised image coordinates.

    ``valid_BN`` marks existing objects. Images are uint8 on disk, and floats from 0 to 1 in
    batches.
    """

    frame_BI3HW: Tensor
    tip_BI2: Tensor
    object_BIN2: Tensor
    valid_BN: Tensor

    def __len__(self) -> int:
        return len(self.frame_BI3HW)

    def at(self, index: Tensor) -> "Clips":
        """The clips of an index tensor, with float images."""
        frame, *others = (value[index] for value in vars(self).values())
        return Clips(frame.float() / 255, *others)

    def to(self, device: torch.device) -> "Clips":
        """Copy on another device."""
        return Clips(*(value.to(device) for value in vars(self).values()))

    def rotated(self, quarter_turns: int, is_mirrored: bool) -> "Clips":
        """Rotate by quarter turns, after mirroring x if asked: the symmetries of a square table."""
        frame, tip, objects = self.frame_BI3HW, self.tip_BI2, self.object_BIN2
        if is_mirrored:
            frame, tip, objects = frame.flip(-1), tip * _MIRROR, objects * _MIRROR
        frame = frame.rot90(quarter_turns, (-2, -1))
        for _ in range(quarter_turns % 4):  # rot90 takes the right side (+x) to the top (-y)
            tip, objects = (torch.stack([p[..., 1], -p[..., 0]], -1) for p in (tip, objects))
        return Clips(frame, tip, objects, self.valid_BN)


def sample_clips(clips: Clips, count: int, rng: np.random.Generator) -> Clips:
    """A batch of random clips that share one random rotation and mirroring."""
    # One rotation for all, since rot90 turns a whole batch alike.
    index = torch.from_numpy(rng.integers(len(clips), size=count))
    return clips.at(index).rotated(int(rng.integers(4)), bool(rng.integers(2)))


def write_clips(clips: Clips, view: OverheadView, folder: Path) -> None:
    """Write ``clips.safetensors``; the file appears whole."""
    write_tensors(vars(clips), folder / CLIPS_FILE, {"format": CLIPS_FORMAT, "view": to_json(view)})


def read_clips(folder: Path) -> tuple[Clips, OverheadView]:
    """Inverse of ``write_clips``. Raises ClipsError."""
    path = folder / CLIPS_FILE
    tensors, metadata = read_tensors(path, CLIPS_FORMAT, ClipsError)
    return Clips(**tensors), from_json(metadata["view"], OverheadView, f"{path}: view")
