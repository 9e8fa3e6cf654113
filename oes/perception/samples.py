"""Training samples: a random state of an episode, some of its views, a query view, ground truth.

The whole world of a sample is rotated about the vertical, mirrored, scaled and shifted. Images need
no resampling for this: only the camera poses and depths change.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.episode import Camera, Floats, Frames
from oes.geom.boxes import aabb
from oes.geom.se3 import rigid, rotation_z
from oes.geom.voxels import Grid
from oes.objects import map_tensors
from oes.perception.lift import Views, views_of
from oes.perception.losses import PerceptionBatch
from oes.perception.solids import Solids
from oes.record.dataset import FrameSource


@params
class Sampling:
    """``views_share[i]``: share of batches with i + 1 input views.

    ``center_jitter_m``, ``size_jitter`` (of the logarithm): standard deviations of the noise on the
    boxes for the second stage. ``scale``: range of the random scale of the world. ``shift_m``: its
    largest horizontal shift per axis.
    """

    views_share: tuple[float, ...]
    center_jitter_m: float
    size_jitter: float
    scale: tuple[float, float]
    shift_m: float


@dataclass(frozen=True)
class WorldTransform:
    """Similarity transform of the world, p -> scale * R p + t; R may contain a reflection."""

    R: Floats
    scale: float
    t: Floats

    def points(self, points_P3: Floats) -> Floats:
        """Transformed points P3."""
        return self.scale * points_P3 @ self.R.T + self.t


IDENTITY = WorldTransform(np.eye(3), 1.0, np.zeros(3))


def random_world_transform(cfg: Sampling, rng: np.random.Generator) -> WorldTransform:
    """Uniform yaw, scale and shift within ``cfg``; a reflection with probability 1/2."""
    mirror = np.diag([1.0, rng.choice([-1.0, 1.0]), 1.0])
    shift = np.append(rng.uniform(-1, 1, 2) * cfg.shift_m, 0)
    R = rotation_z(rng.uniform(0, 2 * np.pi)) @ mirror
    return WorldTransform(R, rng.uniform(*cfg.scale), shift)


@dataclass(frozen=True)
class Sampler:
    """Batches of ``batch`` samples from the episodes ``episode_is`` of ``source``.

    The world of the first ``num_untransformed`` samples of a batch is not transformed. Objects with
    a centre outside ``grid`` are ignored.
    """

    cfg: Sampling
    batch: int
    num_untransformed: int
    seed: int
    grid: Grid
    source: FrameSource
    solids: Solids
    episode_is: Sequence[int]

    def batch_at(self, step: int) -> PerceptionBatch:
        """The batch of a training step, which depends only on the seed and the step."""
        rng = np.random.default_rng((self.seed, step))
        num_views = int(rng.choice(len(self.cfg.views_share), p=self.cfg.views_share)) + 1
        # All transforms are drawn before the samples: part of the order of random numbers.
        worlds = [
            IDENTITY if i < self.num_untransformed else random_world_transform(self.cfg, rng)
            for i in range(self.batch)
        ]
        samples = []
        for world in worlds:
            episode_i = int(rng.choice(self.episode_is))
            steps = self.source.episodes[episode_i].steps
            step_i = int(rng.integers(len(steps)))
            camera_is = rng.choice(len(steps[step_i].cameras), num_views + 1, replace=False)
            samples.append(self.sample(episode_i, step_i, camera_is.tolist(), world, rng))
        return collate(samples)

    def sample(
        self,
        episode_i: int,
        step_i: int,
        camera_is: Sequence[int],
        world: WorldTransform,
        rng: np.random.Generator,
    ) -> PerceptionBatch:
        """One state as a batch of one; the last of ``camera_is`` is the query camera."""
        episode = self.source.episodes[episode_i]
        views = transform_views(*self.source.read(episode_i, step_i, camera_is), world)
        posed = zip(episode.bodies, episode.steps[step_i].world_T_obj_N44, strict=True)
        points = [world.points(self.solids.posed(body, pose)) for body, pose in posed]
        # Boxes are those of the transformed points: a rotated box is not axis-aligned.
        low = np.array(self.grid.min_m)
        boxes = [(*aabb(points_P3), points_P3) for points_P3 in points]
        boxes = [x for x in boxes if ((x[0] > low) & (x[0] < low + self.grid.size_m)).all()]
        center_N3 = np.array([center for center, _, _ in boxes]).reshape(-1, 3)
        size_N3 = np.array([size for _, size, _ in boxes]).reshape(-1, 3)
        num_points = len(next(iter(self.solids.points.values())))
        points_NP3 = np.array([points for _, _, points in boxes]).reshape(-1, num_points, 3)
        region_N3 = center_N3 + rng.normal(0, self.cfg.center_jitter_m, center_N3.shape)
        stretch_N3 = np.exp(rng.normal(0, self.cfg.size_jitter, size_N3.shape))

        def batched(x: Floats) -> Tensor:
            return torch.from_numpy(x).float()[None]

        return PerceptionBatch(
            views=map_tensors(views, lambda x: x[:, :-1]),
            query=map_tensors(views, lambda x: x[:, -1:]),
            center_BN3=batched(center_N3),
            size_BN3=batched(size_N3),
            valid_BN=torch.ones(1, len(boxes), dtype=torch.bool),
            object_points_BNP3=batched(points_NP3),
            region_center_BN3=batched(region_N3),
            region_size_BN3=batched(size_N3 * stretch_N3),
        )


def transform_views(frames: Frames, cameras: Sequence[Camera], world: WorldTransform) -> Views:
    """One scene's images and cameras in a transformed world, as a batch of one."""
    scaled = replace(frames, depth_m_VHW=frames.depth_m_VHW * np.float32(world.scale))
    old_V44 = np.stack([camera.world_T_cam_44 for camera in cameras])
    # The scale is in the positions and depths, so that poses remain rigid.
    new_V44 = rigid(world.R @ old_V44[:, :3, :3], world.points(old_V44[:, :3, 3]))
    poses_BV44 = torch.from_numpy(new_V44).float()[None]
    return replace(views_of(scaled, cameras), world_T_cam_BV44=poses_BV44)


def collate(samples: Sequence[PerceptionBatch]) -> PerceptionBatch:
    """One batch of samples with equally many views, padded to the largest number of objects."""
    # At least one, so that later reductions over objects are never over an empty axis.
    count = max(1, *(sample.valid_BN.shape[1] for sample in samples))

    def pad(x: Tensor, value: float | tuple[float, ...]) -> Any:
        shape = (1, count - x.shape[1], *x.shape[2:])
        return torch.cat([x, x.new_tensor(value).expand(shape)], dim=1)

    # Padded regions are a box on the table, which the second stage learns to score 0. Points that
    # are NaN lie in no voxel.
    values: dict[str, float | tuple[float, ...]] = {
        "center_BN3": 0.0,
        "size_BN3": 1.0,
        "valid_BN": False,
        "object_points_BNP3": torch.nan,
        "region_center_BN3": (0.0, 0.0, 0.04),
        "region_size_BN3": 0.1,
    }
    first, *others = (
        replace(sample, **{name: pad(getattr(sample, name), values[name]) for name in values})
        for sample in samples
    )
    return map_tensors(first, lambda *x: torch.cat(x), *others)
