"""The objects file: perceived objects of many draws (an episode's first state, seen through one set
of views).

One safetensors file, ragged over O objects in D draws; settings by name in its metadata.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from oes.objects import Objects
from oes.perception.surface import MIN_SIGMA_PROFILE_M
from oes.training.tensor_io import read_tensors, write_tensors

OBJECTS_FORMAT = "oes-objects-3"
DTYPES = {
    "draw_O": torch.int32,
    "gt_O": torch.int32,
    "center_O3": torch.float32,
    "size_O3": torch.float32,
    "score_O": torch.float32,
    "crop_OCXYZ": torch.float16,
    "image_OV3HW": torch.uint8,
    "camera_OV12": torch.float32,
    "view_OV": torch.bool,
    "radial_profile_ORD3": torch.float16,
    "com_offset_O3": torch.float32,
    "true_radius_ORK": torch.float16,
    "true_mass_O3": torch.float32,
    "episode_D": torch.int32,
    "setting_D": torch.int32,
    "num_views_D": torch.int32,
    "views_DV": torch.int32,
}


class ObjectsError(ValueError):
    """An objects file that cannot be used; names the file and the reason."""


@dataclass(frozen=True)
class Observation:
    """One scene as perceived: ``gt_N`` is the true object of each (-1: none), ``views`` the cameras
    that saw it.

    ``truth``: radii NRK of the true outlines and true centres of mass N3, from the perceived
    centres (NaN: no object).
    """

    episode_i: int
    setting: str
    views: tuple[int, ...]
    objects: Objects
    gt_N: NDArray[np.int64]
    truth: tuple[Tensor, Tensor]


@dataclass(frozen=True)
class ObjectStore:
    """A file in memory; ``tensors`` has the keys of ``DTYPES``, objects ordered by draw."""

    settings: tuple[str, ...]
    tensors: dict[str, Tensor]
    start_D: Tensor

    def __len__(self) -> int:
        """Number of draws."""
        return len(self.tensors["episode_D"])

    def draws(self, setting: str) -> list[int]:
        """Numbers of the draws of one setting, in the order of episodes. Raises ObjectsError for an
        unknown one.
        """
        if setting not in self.settings:
            raise ObjectsError(f"no setting {setting!r}; there are: {', '.join(self.settings)}")
        is_setting = self.tensors["setting_D"] == self.settings.index(setting)
        return [int(draw_i) for draw_i in is_setting.nonzero()[:, 0]]

    def episode(self, draw_i: int) -> int:
        """The draw's episode: a position in ``list_episodes``."""
        return int(self.tensors["episode_D"][draw_i])

    def views(self, draw_i: int) -> tuple[int, ...]:
        """The cameras that saw the draw."""
        return tuple(int(view) for view in self.tensors["views_DV"][draw_i] if view >= 0)

    def with_gt_surfaces(self) -> "ObjectStore":
        """The same scenes, each object with its true surface and centre of mass; false detections
        as seen.
        """
        radius_ORK, seen_ORK3 = (
            self.tensors["true_radius_ORK"].float(),
            self.tensors["radial_profile_ORD3"].float(),
        )
        sure_ORK = torch.full_like(radius_ORK, MIN_SIGMA_PROFILE_M)
        true_ORK3 = torch.stack([radius_ORK, sure_ORK, (radius_ORK > 0).float()], -1)
        is_true_O = self.tensors["gt_O"] >= 0
        radial_profile_ORD3 = torch.where(is_true_O[:, None, None, None], true_ORK3, seen_ORK3)
        com_offset_O3 = torch.where(
            is_true_O[:, None], self.tensors["true_mass_O3"], self.tensors["com_offset_O3"]
        )
        tensors = self.tensors | {
            "radial_profile_ORD3": radial_profile_ORD3,
            "com_offset_O3": com_offset_O3,
        }
        return ObjectStore(self.settings, tensors, self.start_D)

    def scene(self, draw_i: int) -> tuple[Objects, Tensor]:
        """The draw's objects (unbatched, float32, all valid; views padded) and ``gt_N`` (-1:
        none).
        """
        rows = slice(int(self.start_D[draw_i]), int(self.start_D[draw_i + 1]))
        part = {name: value[rows] for name, value in self.tensors.items() if "_O" in name}
        objects = Objects(
            center_N3=part["center_O3"],
            size_N3=part["size_O3"],
            score_N=part["score_O"],
            valid_N=torch.ones(len(part["score_O"]), dtype=torch.bool),
            crop_NCXYZ=part["crop_OCXYZ"].float(),
            image_NV3HW=part["image_OV3HW"],
            camera_NV12=part["camera_OV12"],
            view_NV=part["view_OV"],
            radial_profile_NRD3=part["radial_profile_ORD3"].float(),
            com_offset_N3=part["com_offset_O3"],
        )
        return objects, part["gt_O"].long()


def pack(
    draws: Sequence[Observation], settings: Sequence[str], num_views: int
) -> dict[str, Tensor]:
    """Draws as the tensors of a file whose views are padded to ``num_views``."""
    scenes = [draw.objects for draw in draws]
    counts = torch.tensor([len(scene.score_N) for scene in scenes], dtype=torch.int64)
    views = [[*draw.views, *[-1] * (num_views - len(draw.views))] for draw in draws]
    tensors = {
        "draw_O": torch.repeat_interleave(torch.arange(len(draws)), counts),
        "gt_O": torch.cat([torch.as_tensor(draw.gt_N) for draw in draws]),
        "center_O3": torch.cat([scene.center_N3 for scene in scenes]),
        "size_O3": torch.cat([scene.size_N3 for scene in scenes]),
        "score_O": torch.cat([scene.score_N for scene in scenes]),
        "crop_OCXYZ": torch.cat([scene.crop_NCXYZ for scene in scenes]),
        "image_OV3HW": torch.cat([_padded(scene.image_NV3HW, num_views) for scene in scenes]),
        "camera_OV12": torch.cat([_padded(scene.camera_NV12, num_views) for scene in scenes]),
        "view_OV": torch.cat([_padded(scene.view_NV, num_views) for scene in scenes]),
        "radial_profile_ORD3": torch.cat([scene.radial_profile_NRD3 for scene in scenes]),
        "com_offset_O3": torch.cat([scene.com_offset_N3 for scene in scenes]),
        "true_radius_ORK": torch.cat([draw.truth[0] for draw in draws]),
        "true_mass_O3": torch.cat([draw.truth[1] for draw in draws]),
        "episode_D": torch.tensor([draw.episode_i for draw in draws]),
        "setting_D": torch.tensor([settings.index(draw.setting) for draw in draws]),
        "num_views_D": torch.tensor([len(draw.views) for draw in draws]),
        "views_DV": torch.tensor(views, dtype=torch.int32).reshape(len(draws), num_views),
    }
    return {name: tensors[name].to(dtype).contiguous() for name, dtype in DTYPES.items()}


def joined(shards: Sequence[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Shards of ``pack``, one after the other; draws are renumbered."""
    first = np.cumsum([0, *(len(shard["episode_D"]) for shard in shards)])
    moved = [
        shard | {"draw_O": shard["draw_O"] + int(start)}
        for shard, start in zip(shards, first, strict=False)
    ]
    return {name: torch.cat([shard[name] for shard in moved]) for name in DTYPES}


def write_objects(path: Path, tensors: dict[str, Tensor], settings: Sequence[str]) -> None:
    """Write packed tensors; ``settings`` are the names that ``setting_D`` counts."""
    write_tensors(tensors, path, {"format": OBJECTS_FORMAT, "settings": json.dumps(list(settings))})


def read_objects(path: Path) -> ObjectStore:
    """Read a whole file. Raises ObjectsError: missing, unreadable, foreign, or tensors that do not
    belong together.
    """
    tensors, about = read_tensors(path, OBJECTS_FORMAT, ObjectsError)
    if {name: value.dtype for name, value in tensors.items()} != DTYPES:
        raise ObjectsError(f"{path}: not an objects file of this version ({OBJECTS_FORMAT})")
    counts = torch.bincount(tensors["draw_O"].long(), minlength=len(tensors["episode_D"]))
    lengths = {len(tensors[name]) for name in DTYPES if "_O" in name}
    if (
        len(lengths) != 1
        or len(counts) != len(tensors["episode_D"])
        or (tensors["draw_O"].diff() < 0).any()
    ):
        raise ObjectsError(f"{path}: objects and draws do not belong together")
    start_D = torch.cat([torch.zeros(1, dtype=torch.int64), counts.cumsum(0)])
    return ObjectStore(tuple(json.loads(about["settings"])), tensors, start_D)


def _padded(tensor_NV: Tensor, num_views: int) -> Tensor:
    """Zeros for the views that do not exist."""
    count, found = tensor_NV.shape[:2]
    return torch.cat(
        [tensor_NV, tensor_NV.new_zeros(count, num_views - found, *tensor_NV.shape[2:])], dim=1
    )
