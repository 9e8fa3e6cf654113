"""The objects file: perceived objects of many observations, in one safetensors file.

An observation is the first state of an episode, perceived under one setting. Object tensors
concatenate the O objects of all U observations; the metadata holds the names of the settings.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from oes.objects import Objects
from oes.perception.surface import MIN_RADIUS_SCALE_M
from oes.training.tensor_io import read_tensors, write_tensors

OBJECTS_FORMAT = "oes-objects-4"
FIELD_DTYPES = {  # fields of ``Objects``; in the file, O takes the place of N
    "center_N3": torch.float32,
    "size_N3": torch.float32,
    "score_N": torch.float32,
    "crop_NCXYZ": torch.float16,
    "image_NV3HW": torch.uint8,
    "camera_NV12": torch.float32,
    "view_NV": torch.bool,
    "radial_profile_NRD3": torch.float16,
    "com_offset_N3": torch.float32,
}
DTYPES = {name.replace("_N", "_O"): dtype for name, dtype in FIELD_DTYPES.items()} | {
    "observation_O": torch.int32,
    "gt_O": torch.int32,
    "gt_radius_ORD": torch.float16,
    "gt_com_offset_O3": torch.float32,
    "episode_U": torch.int32,
    "setting_U": torch.int32,
    "num_views_U": torch.int32,
    "views_UV": torch.int32,
}


class ObjectsError(ValueError):
    """An objects file that cannot be used; names the file and the reason."""


@dataclass(frozen=True)
class Observation:
    """One episode perceived under one setting; ``views`` are the indices of its cameras.

    ``gt_N``: ground-truth object of each perceived one (-1: none). ``gt_surface``: radii NRD and
    centres of mass N3 of these, relative to the perceived centres (NaN: no object).
    """

    episode_i: int
    setting: str
    views: tuple[int, ...]
    objects: Objects
    gt_N: NDArray[np.int64]
    gt_surface: tuple[Tensor, Tensor]


@dataclass(frozen=True)
class ObjectStore:
    """A file in memory; ``tensors`` has the keys of ``DTYPES``, objects ordered by observation."""

    settings: tuple[str, ...]
    tensors: dict[str, Tensor]

    def __len__(self) -> int:
        return len(self.tensors["episode_U"])

    def observations(self, setting: str) -> list[int]:
        """Indices of the observations of one setting, ordered by episode. Raises ObjectsError."""
        if setting not in self.settings:
            raise ObjectsError(f"no setting {setting!r}; there are: {', '.join(self.settings)}")
        is_setting_U = self.tensors["setting_U"] == self.settings.index(setting)
        return [int(i) for i in is_setting_U.nonzero()[:, 0]]

    def episode(self, observation_i: int) -> int:
        """Index of the observation's episode in ``list_episodes``."""
        return int(self.tensors["episode_U"][observation_i])

    def views(self, observation_i: int) -> tuple[int, ...]:
        """Indices of the observation's cameras."""
        return tuple(int(view) for view in self.tensors["views_UV"][observation_i] if view >= 0)

    def with_gt_surfaces(self) -> "ObjectStore":
        """The same scenes with the ground-truth surface and centre of mass of every object.

        False detections keep the predicted ones.
        """
        old, radius_ORD = self.tensors, self.tensors["gt_radius_ORD"].float()
        scale_ORD = torch.full_like(radius_ORD, MIN_RADIUS_SCALE_M)
        gt_ORD3 = torch.stack([radius_ORD, scale_ORD, (radius_ORD > 0).float()], -1)
        is_true_O1, old_ORD3 = old["gt_O"][:, None] >= 0, old["radial_profile_ORD3"].float()
        profile_ORD3 = torch.where(is_true_O1[..., None, None], gt_ORD3, old_ORD3)
        com_offset_O3 = torch.where(is_true_O1, old["gt_com_offset_O3"], old["com_offset_O3"])
        new = {"radial_profile_ORD3": profile_ORD3, "com_offset_O3": com_offset_O3}
        return ObjectStore(self.settings, old | new)

    def scene(self, observation_i: int) -> tuple[Objects, Tensor]:
        """Objects (unbatched, float32, views padded) and ``gt_N`` (-1: none)."""
        limits = torch.tensor([observation_i, observation_i + 1], dtype=torch.int32)
        start, stop = torch.searchsorted(self.tensors["observation_O"], limits).tolist()
        part = {}
        for name in FIELD_DTYPES:
            value = self.tensors[name.replace("_N", "_O")][start:stop]
            part[name] = value.float() if value.is_floating_point() else value
        valid_N = torch.ones(stop - start, dtype=torch.bool)
        return Objects(valid_N=valid_N, **part), self.tensors["gt_O"][start:stop].long()


def pack(
    observations: Sequence[Observation], settings: Sequence[str], num_views: int
) -> dict[str, Tensor]:
    """The tensors of a file whose views are padded to ``num_views``."""
    scenes = [x.objects for x in observations]
    counts = torch.tensor([len(scene.score_N) for scene in scenes], dtype=torch.int64)
    views = [[*x.views, *[-1] * (num_views - len(x.views))] for x in observations]
    tensors = {
        "observation_O": torch.repeat_interleave(torch.arange(len(scenes)), counts),
        "gt_O": torch.cat([torch.as_tensor(x.gt_N) for x in observations]),
        "gt_radius_ORD": torch.cat([x.gt_surface[0] for x in observations]),
        "gt_com_offset_O3": torch.cat([x.gt_surface[1] for x in observations]),
        "episode_U": torch.tensor([x.episode_i for x in observations]),
        "setting_U": torch.tensor([settings.index(x.setting) for x in observations]),
        "num_views_U": torch.tensor([len(x.views) for x in observations]),
        "views_UV": torch.tensor(views, dtype=torch.int32).reshape(len(views), num_views),
    }
    for name in FIELD_DTYPES:
        fields = [getattr(scene, name) for scene in scenes]
        if "_NV" in name:
            later_axes = (0, 0) * (fields[0].dim() - 2)
            fields = [F.pad(x, (*later_axes, 0, num_views - x.shape[1])) for x in fields]
        tensors[name.replace("_N", "_O")] = torch.cat(fields)
    return {name: tensors[name].to(dtype).contiguous() for name, dtype in DTYPES.items()}


def concat(shards: Sequence[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Concatenation of the results of ``pack``; observations are renumbered."""
    start, renumbered = 0, []
    for shard in shards:
        renumbered.append(shard | {"observation_O": shard["observation_O"] + start})
        start += len(shard["episode_U"])
    return {name: torch.cat([shard[name] for shard in renumbered]) for name in DTYPES}


def write_objects(path: Path, tensors: dict[str, Tensor], settings: Sequence[str]) -> None:
    """Write packed tensors; ``settings`` are the names that ``setting_U`` indexes."""
    write_tensors(tensors, path, {"format": OBJECTS_FORMAT, "settings": json.dumps(list(settings))})


def read_objects(path: Path) -> ObjectStore:
    """Read a whole file. Raises ObjectsError: missing, unreadable, or inconsistent."""
    tensors, metadata = read_tensors(path, OBJECTS_FORMAT, ObjectsError)
    if {name: value.dtype for name, value in tensors.items()} != DTYPES:
        raise ObjectsError(f"{path}: not an objects file of this version ({OBJECTS_FORMAT})")
    observation_O, num_observations = tensors["observation_O"], len(tensors["episode_U"])
    lengths = {len(tensors[name]) for name in DTYPES if "_O" in name}
    is_valid_O = (observation_O >= 0) & (observation_O < num_observations)
    is_sorted = (observation_O.diff() >= 0).all()
    if len(lengths) > 1 or not is_sorted or not is_valid_O.all():
        raise ObjectsError(f"{path}: objects and observations do not belong together")
    return ObjectStore(tuple(json.loads(metadata["settings"])), tensors)
