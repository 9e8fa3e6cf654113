"""Training samples: any state of any episode, some random views of it, one query view, and the true
solids.

Every sample moves the whole world: turned about the vertical, mirrored, scaled and shifted. That
costs nothing, since the network sees the world only through camera poses and depths.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.episode import Camera, Episode, Floats, Frames
from oes.geom.boxes import aabb
from oes.geom.se3 import rigid, rotation_z
from oes.geom.voxels import Grid
from oes.perception.lift import Views
from oes.perception.losses import PerceptionBatch
from oes.perception.solids import Solids


@params
class Sampling:
    """``views_share[i]``: share of batches with i + 1 input views. Jitters are standard deviations
    of the boxes given to the second stage. ``scale`` is the range of world scales, ``shift_m`` the
    largest horizontal shift.
    """

    views_share: tuple[float, ...]
    center_jitter_m: float
    size_jitter: float
    scale: tuple[float, float]
    shift_m: float


class Source(Protocol):
    """The states of all episodes and, at random, their images, as
    ``oes.record.dataset.FrameSource`` has them.
    """

    episodes: list[Episode]

    def read(
        self, episode_i: int, step_i: int, camera_is: Sequence[int]
    ) -> tuple[Frames, tuple[Camera, ...]]:
        """Images of one state and their cameras, in the order of ``camera_is``."""


@dataclass(frozen=True)
class WorldTransform:
    """A similarity of the world: turn (or turn and mirror) R, scale, shift t: p -> scale * R p +
    t.
    """

    R: Floats
    scale: float
    t: Floats

    def poses(self, cameras: Sequence[Camera]) -> Floats:
        """world_T_cam V44 of the cameras in the moved world; their depths grow by ``scale``."""
        world_T_cam = np.stack([camera.world_T_cam_44 for camera in cameras])
        return rigid(
            self.R @ world_T_cam[:, :3, :3], self.scale * world_T_cam[:, :3, 3] @ self.R.T + self.t
        )

    def points(self, points_P3: Floats) -> Floats:
        """Moved points P3."""
        return self.scale * points_P3 @ self.R.T + self.t


IDENTITY = WorldTransform(np.eye(3), 1.0, np.zeros(3))


def random_world_transform(cfg: Sampling, rng: np.random.Generator) -> WorldTransform:
    """A turn by any angle, mirrored half of the time, scaled and shifted within the bounds of
    ``cfg``.
    """
    mirror = np.diag([1.0, rng.choice([-1.0, 1.0]), 1.0])
    shift = np.append(rng.uniform(-1, 1, 2) * cfg.shift_m, 0)
    return WorldTransform(
        rotation_z(rng.uniform(0, 2 * np.pi)) @ mirror, rng.uniform(*cfg.scale), shift
    )


@dataclass(frozen=True)
class Sampler:
    """Batches of some episodes of a source; the first ``num_still`` samples of each show the world
    unmoved.

    ``grid`` bounds the objects that count: those whose centre lies inside.
    """

    cfg: Sampling
    batch: int
    num_still: int
    seed: int
    grid: Grid
    source: Source
    solids: Solids
    episode_is: Sequence[int]

    def batch_at(self, step: int) -> PerceptionBatch:
        """The batch of a training step: a function of the seed and the step alone."""
        rng = np.random.default_rng((self.seed, step))
        num_views = int(rng.choice(len(self.cfg.views_share), p=self.cfg.views_share)) + 1
        motions = [
            IDENTITY if i < self.num_still else random_world_transform(self.cfg, rng)
            for i in range(self.batch)
        ]
        return collate([self._random(num_views, motion, rng) for motion in motions])

    def _random(
        self, num_views: int, motion: WorldTransform, rng: np.random.Generator
    ) -> PerceptionBatch:
        episode_i = int(rng.choice(self.episode_is))
        steps = self.source.episodes[episode_i].steps
        step_i = int(rng.integers(len(steps)))
        cameras = rng.choice(len(steps[step_i].cameras), num_views + 1, replace=False)
        return self.sample(episode_i, step_i, cameras.tolist(), motion, rng)

    def sample(
        self,
        episode_i: int,
        step_i: int,
        camera_is: Sequence[int],
        motion: WorldTransform,
        rng: np.random.Generator,
    ) -> PerceptionBatch:
        """One state seen by all but the last of ``camera_is`` (that one is the query), as a batch
        of one.
        """
        episode = self.source.episodes[episode_i]
        step = episode.steps[step_i]
        views = transform_views(*self.source.read(episode_i, step_i, camera_is), motion)
        posed = zip(episode.bodies, step.world_T_obj_N44, strict=True)
        solids = [motion.points(self.solids.posed(body, pose)) for body, pose in posed]
        boxes = [aabb(points) for points in solids]
        inside = [i for i, (center, _) in enumerate(boxes) if _is_inside(self.grid, center)]
        center_N3 = np.array([boxes[i][0] for i in inside]).reshape(-1, 3)
        size_N3 = np.array([boxes[i][1] for i in inside]).reshape(-1, 3)
        regions = center_N3 + rng.normal(0, self.cfg.center_jitter_m, center_N3.shape)
        stretch = np.exp(rng.normal(0, self.cfg.size_jitter, size_N3.shape))
        tensors = [
            center_N3,
            size_N3,
            np.ones(len(inside), dtype=bool),
            [solids[i] for i in inside],
        ]
        center, size, valid, solid = (np.asarray(value)[None] for value in tensors)
        num_points = next(iter(self.solids.points.values())).shape[0]
        return PerceptionBatch(
            views=_pick(views, slice(0, -1)),
            query=_pick(views, slice(-1, None)),
            center_BN3=torch.from_numpy(center).float(),
            size_BN3=torch.from_numpy(size).float(),
            valid_BN=torch.from_numpy(valid),
            solid_BNP3=torch.from_numpy(solid.reshape(1, len(inside), num_points, 3)).float(),
            region_center_BN3=torch.from_numpy(regions[None]).float(),
            region_size_BN3=torch.from_numpy((size_N3 * stretch)[None]).float(),
        )


def transform_views(frames: Frames, cameras: Sequence[Camera], motion: WorldTransform) -> Views:
    """One scene's images and cameras in a moved world, as a batch of one."""
    return Views(
        rgb_BVHW3=torch.from_numpy(frames.rgb_VHW3.copy())[None].float() / 255,
        depth_m_BVHW=torch.from_numpy(frames.depth_m_VHW * np.float32(motion.scale))[None],
        K_BV33=torch.from_numpy(np.stack([camera.K_33 for camera in cameras])).float()[None],
        world_T_cam_BV44=torch.from_numpy(motion.poses(cameras)).float()[None],
    )


def collate(samples: Sequence[PerceptionBatch]) -> PerceptionBatch:
    """One batch of samples with equally many views; objects padded to the largest count (at least
    one).

    Padding is NaN in the solids, and in the regions a box on the table where there may be nothing,
    which teaches the second stage to say so.
    """
    most = max(1, *(sample.valid_BN.shape[1] for sample in samples))
    empty = torch.tensor([[[0.0, 0.0, 0.04]]]), torch.full((1, 1, 3), 0.1)

    def padded(name: str, value: float) -> Tensor:
        tensors = [getattr(sample, name) for sample in samples]
        shapes = [(1, most - tensor.shape[1], *tensor.shape[2:]) for tensor in tensors]
        return torch.cat(
            [
                torch.cat([t, t.new_full(s, value)], dim=1)
                for t, s in zip(tensors, shapes, strict=True)
            ]
        )

    valid = padded("valid_BN", False)
    absent = ~valid[..., None]
    return PerceptionBatch(
        views=_joined([sample.views for sample in samples]),
        query=_joined([sample.query for sample in samples]),
        center_BN3=padded("center_BN3", 0.0),
        size_BN3=padded("size_BN3", 1.0),
        valid_BN=valid,
        solid_BNP3=padded("solid_BNP3", torch.nan),
        region_center_BN3=torch.where(absent, empty[0], padded("region_center_BN3", 0.0)),
        region_size_BN3=torch.where(absent, empty[1], padded("region_size_BN3", 1.0)),
    )


def _is_inside(grid: Grid, center_3: Floats) -> bool:
    low = np.array(grid.min_m)
    return bool(((center_3 > low) & (center_3 < low + grid.size_m)).all())


def _pick(views: Views, which: slice) -> Views:
    return Views(**{name: value[:, which] for name, value in vars(views).items()})


def _joined(views: Sequence[Views]) -> Views:
    return Views(
        **{name: torch.cat([getattr(view, name) for view in views]) for name in vars(views[0])}
    )
