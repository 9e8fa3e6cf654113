"""The objects stage: perceive the first state of every episode under every setting.

The views of test episodes are nested: the set of two views contains the single view, and so on, so
that settings differ only in the number of views.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.episode import Ints
from oes.meshes.catalogue import TRAIN
from oes.objects import Objects
from oes.perception import evaluate
from oes.perception.evaluate import PerceptionRow
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.network import SceneFeatures
from oes.perception.objects_file import OBJECTS_FORMAT, ObjectsError, Observation, concat, pack
from oes.perception.perceiver import Perceiver
from oes.perception.solids import Solids
from oes.perception.surface import support_points
from oes.progress import resumable_map
from oes.record.dataset import FrameSource
from oes.training.tensor_io import read_tensors, write_tensors

GT, JITTERED, PREDICTED = "gt", "jittered", "predicted"
FIXED_CAMERA = 0  # in place of a number of random views
SCORED_VIEWS = (1, 3)


@dataclass(frozen=True)
class Setting:
    """Number of random views (or ``FIXED_CAMERA``) and source of the boxes."""

    views: int
    boxes: str


TRAIN_SETTINGS = {f"train{count}": Setting(count, JITTERED) for count in (1, 2, 3)} | {
    "fixed": Setting(FIXED_CAMERA, JITTERED)
}
TEST_SETTINGS = {
    "3views_gt": Setting(3, GT),
    "1view_gt": Setting(1, GT),
    "1view_pred": Setting(1, PREDICTED),
    "fixed_pred": Setting(FIXED_CAMERA, PREDICTED),
    "2views_pred": Setting(2, PREDICTED),
    "3views_pred": Setting(3, PREDICTED),
    "5views_pred": Setting(5, PREDICTED),
}


@params
class ObjectsConfig:
    """The section ``objects`` of params.yaml.

    ``fixed_camera``: index of the camera of the fixed-view settings. Jitters are standard
    deviations of the noise on ground-truth boxes at training. ``train_observations``: number of
    random sets of views an episode gets under each training setting. ``test_settings``: those of a
    task's test splits (all, for a split that is not named). ``num_workers`` processes (-1: one a
    core; one on a GPU) take ``shard_episodes`` at a time.
    """

    seed: int
    num_workers: int
    fixed_camera: int
    center_jitter_m: float
    size_jitter: float
    train_observations: dict[str, int]
    test_settings: dict[str, dict[str, tuple[str, ...]]]
    shard_episodes: int
    num_solid_points: int

    def __post_init__(self) -> None:
        """Raises ValueError for an unknown or missing setting."""
        if set(counts := self.train_observations) != set(TRAIN_SETTINGS):
            valid = ", ".join(TRAIN_SETTINGS)
            raise ValueError(f"train_observations: expected exactly {valid}; found {dict(counts)}")
        for task, splits in self.test_settings.items():
            for split, names in splits.items():
                if unknown := ", ".join(sorted(set(names) - set(TEST_SETTINGS))):
                    key, valid = f"test_settings.{task}.{split}", ", ".join(TEST_SETTINGS)
                    raise ValueError(f"{key}: unknown {unknown}; there are: {valid}")

    def settings(self, task: str, split: str) -> dict[str, Setting]:
        """The settings of a split, in their order."""
        if split == TRAIN:
            return TRAIN_SETTINGS
        chosen = self.test_settings.get(task, {}).get(split, tuple(TEST_SETTINGS))
        return {name: setting for name, setting in TEST_SETTINGS.items() if name in chosen}


@dataclass(frozen=True)
class ScenePerceiver:
    """Perceives the episodes of one split; ``solids``: ground truth of masks (test splits only)."""

    cfg: ObjectsConfig
    settings: dict[str, Setting]
    perceiver: Perceiver
    source: FrameSource
    gt_profiles: GroundTruthProfiles
    solids: Solids | None

    def perceive(
        self, episode_i: int
    ) -> tuple[list[Observation], list[PerceptionRow], list[PerceptionRow]]:
        """Observations of one episode and, at test, the rows of detections.csv and views.csv."""
        rng = np.random.default_rng((self.cfg.seed, episode_i))
        observations: list[Observation] = []
        detections: list[PerceptionRow] = []
        predictions: list[PerceptionRow] = []
        episode = self.source.episodes[episode_i]
        camera_is = range(len(episode.steps[0].cameras))
        order = rng.permutation(camera_is).tolist()
        all_frames, all_cameras = self.source.read(episode_i, 0, camera_is)
        for views, names in self._view_sets(order):
            frames, cameras = all_frames.of(views), [all_cameras[i] for i in views]
            scene = self.perceiver.encode(frames, cameras)
            for name in names:
                boxes, gt_N = self._boxes(self.settings[name].boxes, scene, episode_i, rng)
                objects = self.perceiver.objects(scene, boxes, frames, cameras)
                surface = self._gt_surface(episode_i, objects, gt_N)
                parts = tuple(views), objects, gt_N, surface
                observations.append(Observation(episode_i, name, *parts))
            if self.solids is not None and self.settings[names[0]].views in SCORED_VIEWS:
                key: PerceptionRow = {"episode": episode_i, "step": 0, "num_views": len(views)}
                truth = evaluate.gt_objects(episode, 0, self.solids)
                rows = evaluate.detection_rows(self.perceiver, scene, truth)
                detections += [key | row for row in rows]
                query_i = order[-1]
                image_HW3 = self.perceiver.render(scene, all_cameras[query_i])
                quality = evaluate.rgb_quality(image_HW3, all_frames.rgb_VHW3[query_i])
                predictions.append(key | {"camera": query_i} | quality)
        return observations, detections, predictions

    def _gt_surface(self, episode_i: int, objects: Objects, gt_N: Ints) -> tuple[Tensor, Tensor]:
        """Ground-truth radii NRD and relative centres of mass N3 (NaN: no object)."""
        radius_NRD = torch.full(objects.radial_profile_NRD3.shape[:-1], torch.nan)
        com_N3 = torch.full_like(objects.center_N3, torch.nan)
        matched, episode = np.flatnonzero(gt_N >= 0), self.source.episodes[episode_i]
        bodies = [episode.bodies[i] for i in gt_N[matched]]
        poses = episode.steps[0].world_T_obj_N44[gt_N[matched]]
        support_N3 = support_points(objects.center_N3, objects.size_N3)[matched].double().numpy()
        radius, com = self.gt_profiles.of_bodies(bodies, poses, support_N3)
        radius_NRD[matched] = torch.from_numpy(radius).float()
        com_N3[matched] = torch.from_numpy(com).float()
        return radius_NRD, com_N3 - objects.center_N3

    def _view_sets(self, order: list[int]) -> Iterator[tuple[list[int], list[str]]]:
        """Sets of views to encode, each with the settings that use it.

        The last camera of ``order`` is in no random set: its view is predicted.
        """
        if self.solids is None:
            left = order
            for name, count in self.cfg.train_observations.items():
                for _ in range(count):
                    views = left[: self.settings[name].views] or [self.cfg.fixed_camera]
                    # Used cameras go to the end, so that sets share as few as possible.
                    left = [*left[len(views) :], *views]
                    yield views, [name]
            return
        shared: dict[int, list[str]] = {}
        for name, setting in self.settings.items():
            shared.setdefault(setting.views, []).append(name)
        for count, names in shared.items():
            yield order[:count] or [self.cfg.fixed_camera], names

    def _boxes(
        self, kind: str, scene: SceneFeatures, episode_i: int, rng: np.random.Generator
    ) -> tuple[tuple[Tensor, Tensor, Tensor], Ints]:
        """Centres N3, sizes N3, scores N; the ground-truth object N of each (-1: none)."""
        step = self.source.episodes[episode_i].steps[0]
        center_N3, size_N3, cfg = step.center_N3, step.size_N3, self.cfg
        if kind == PREDICTED:
            centers, sizes, scores = (value.float().cpu() for value in self.perceiver.detect(scene))
            gt_N = evaluate.match_detections(centers.double().numpy(), center_N3)
            return (centers, sizes, scores), gt_N
        if kind == JITTERED:
            center_N3 = center_N3 + rng.normal(0, cfg.center_jitter_m, center_N3.shape)
            size_N3 = size_N3 * np.exp(rng.normal(0, cfg.size_jitter, size_N3.shape))
        boxes = torch.from_numpy(center_N3).float(), torch.from_numpy(size_N3).float()
        return (*boxes, torch.ones(len(center_N3))), np.arange(len(center_N3))


def perceive_split(
    scenes: ScenePerceiver, progress: Path
) -> tuple[dict[str, Tensor], list[PerceptionRow], list[PerceptionRow]]:
    """All observations of a split, packed, and its rows of detections.csv and views.csv.

    Finished shards of episodes are kept in ``progress`` and reused.
    """
    cfg, episode_is = scenes.cfg, range(len(scenes.source.episodes))
    size = cfg.shard_episodes
    shards = {
        progress / f"shard_{start:06d}.safetensors": episode_is[start : start + size]
        for start in episode_is[::size]
    }
    num_workers = cfg.num_workers if scenes.perceiver.device.type == "cpu" else 1
    write = partial(_write_shard, scenes)
    resumable_map(write, shards, num_workers=num_workers, desc="perceiving", unit="shard")
    files = [read_tensors(path, OBJECTS_FORMAT, ObjectsError) for path in shards]
    tables = [json.loads(metadata["rows"]) for _, metadata in files]
    detections, views = ([row for pair in tables for row in pair[i]] for i in (0, 1))
    return concat([tensors for tensors, _ in files]), detections, views


def _write_shard(scenes: ScenePerceiver, episode_is: range, path: Path) -> None:
    episodes = [scenes.perceive(episode_i) for episode_i in episode_is]
    observations = [observation for episode in episodes for observation in episode[0]]
    rows = [[row for episode in episodes for row in episode[table]] for table in (1, 2)]
    num_views = max(setting.views for setting in scenes.settings.values())
    tensors = pack(observations, list(scenes.settings), num_views)
    write_tensors(tensors, path, {"format": OBJECTS_FORMAT, "rows": json.dumps(rows)})
