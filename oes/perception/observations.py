"""The objects stage's work: perceive the first state of every episode under every setting, and
score it at test.

Views of test episodes are nested (two views are the one view and another), so that settings differ
in nothing else.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from joblib import Parallel, delayed
from numpy.typing import NDArray
from safetensors.torch import load_file
from torch import Tensor
from tqdm import tqdm

from oes.config import params
from oes.geom.boxes import support_height
from oes.meshes.catalogue import TRAIN
from oes.objects import Objects
from oes.perception.evaluate import (
    PerceptionRow,
    detection_rows,
    match_detections,
    true_objects,
    view_row,
)
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.network import SceneFeatures
from oes.perception.objects_file import Observation, joined, pack
from oes.perception.perceiver import Perceiver
from oes.perception.samples import Source
from oes.perception.solids import Solids
from oes.training.tensor_io import write_tensors

FIXED, TRUE, JITTERED, PREDICTED = "fixed", "true", "jittered", "found"
SCORED_VIEWS = (1, 3)


@dataclass(frozen=True)
class Setting:
    """How many random views (``FIXED``: the one nominal camera), and which boxes."""

    views: int | str
    boxes: str


TRAIN_SETTINGS = {
    "train1": Setting(1, JITTERED),
    "train2": Setting(2, JITTERED),
    "train3": Setting(3, JITTERED),
    "fixed": Setting(FIXED, JITTERED),
}
TEST_SETTINGS = {
    "3views_gt": Setting(3, TRUE),
    "1view_gt": Setting(1, TRUE),
    "1view_pred": Setting(1, PREDICTED),
    "fixed_pred": Setting(FIXED, PREDICTED),
    "2views_pred": Setting(2, PREDICTED),
    "3views_pred": Setting(3, PREDICTED),
    "5views_pred": Setting(5, PREDICTED),
}


@params
class ObjectsConfig:
    """The section ``objects`` of params.yaml.

    ``fixed_camera``: index of the camera of the fixed-view settings. Jitters are standard
    deviations of the true boxes at training; ``train_draws``: how many sets of views an episode
    gets under each training setting; ``test_settings``: those of a task's test splits (all, for a
    split that is not named). ``num_workers`` processes (-1: one a core) share the work,
    ``shard_episodes`` at a time; on a GPU one does it all.
    """

    seed: int
    num_workers: int
    fixed_camera: int
    center_jitter_m: float
    size_jitter: float
    train_draws: dict[str, int]
    test_settings: dict[str, dict[str, tuple[str, ...]]]
    shard_episodes: int
    num_solid_points: int

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from params.yaml) for an unknown or missing
        setting.
        """
        if set(self.train_draws) != set(TRAIN_SETTINGS):
            raise ValueError(
                f"train_draws: expected exactly {', '.join(TRAIN_SETTINGS)}; found {dict(self.train_draws)}"
            )
        for task, splits in self.test_settings.items():
            for split, names in splits.items():
                if unknown := set(names) - set(TEST_SETTINGS):
                    raise ValueError(
                        f"test_settings.{task}.{split}: unknown {', '.join(sorted(unknown))}; "
                        f"there are: {', '.join(TEST_SETTINGS)}"
                    )

    def settings(self, task: str, split: str) -> dict[str, Setting]:
        """Those of a split, in their order."""
        if split == TRAIN:
            return TRAIN_SETTINGS
        asked = self.test_settings.get(task, {}).get(split, tuple(TEST_SETTINGS))
        return {name: setting for name, setting in TEST_SETTINGS.items() if name in asked}


@dataclass(frozen=True)
class ScenePerceiver:
    """Perceives the episodes of one split under ``settings``; ``solids`` scores the masks of a test
    split, None for training.
    """

    cfg: ObjectsConfig
    settings: dict[str, Setting]
    perceiver: Perceiver
    source: Source
    shells: GroundTruthProfiles
    solids: Solids | None

    def episode(
        self, episode_i: int
    ) -> tuple[list[Observation], list[PerceptionRow], list[PerceptionRow]]:
        """Draws of one episode and, at test, the rows of detections.csv and views.csv."""
        rng = np.random.default_rng((self.cfg.seed, episode_i))
        draws: list[Observation] = []
        detections: list[PerceptionRow] = []
        predictions: list[PerceptionRow] = []
        every_camera = range(len(self.source.episodes[episode_i].steps[0].cameras))
        order = rng.permutation(every_camera).tolist()
        every_frame, rig = self.source.read(episode_i, 0, every_camera)
        for views, names in self._plan(order):
            frames, cameras = every_frame.of(views), [rig[camera_i] for camera_i in views]
            scene = self.perceiver.encode(frames, cameras)
            for name in names:
                centers, sizes, scores, gt_N = self._boxes(
                    self.settings[name].boxes, scene, episode_i, rng
                )
                objects = self.perceiver.objects(scene, centers, sizes, scores, frames, cameras)
                draws.append(
                    Observation(
                        episode_i,
                        name,
                        tuple(views),
                        objects,
                        gt_N,
                        self._truth(episode_i, objects, gt_N),
                    )
                )
            if self.solids is not None and self.settings[names[0]].views in SCORED_VIEWS:
                seen: PerceptionRow = {"episode": episode_i, "step": 0, "num_views": len(views)}
                truth = true_objects(self.source.episodes[episode_i], 0, self.solids)
                detections += [seen | row for row in detection_rows(self.perceiver, scene, truth)]
                query_i = order[-1]
                row = view_row(self.perceiver, scene, every_frame.of([query_i]), rig[query_i])
                predictions.append(seen | {"camera": query_i} | row)
        return draws, detections, predictions

    def _truth(
        self, episode_i: int, objects: Objects, gt_N: NDArray[np.int64]
    ) -> tuple[Tensor, Tensor]:
        """True outlines' radii NRK and centres of mass N3 of perceived objects, from their
        perceived centres.
        """
        radius_NRK = torch.full(objects.radial_profile_NRD3.shape[:-1], torch.nan)
        mass_N3 = torch.full_like(objects.center_N3, torch.nan)
        found = np.flatnonzero(gt_N >= 0)
        foot_N3 = objects.center_N3.clone()
        foot_N3[:, 2] = support_height(objects.center_N3, objects.size_N3)
        true_radius, true_mass = self.shells.outlines(
            self.source.episodes[episode_i],
            0,
            foot_N3[found].double().numpy(),
            gt_N[found].tolist(),
        )
        radius_NRK[found], mass_N3[found] = (
            torch.from_numpy(true_radius).float(),
            torch.from_numpy(true_mass).float(),
        )
        return radius_NRK, mass_N3 - objects.center_N3

    def _plan(self, order: Sequence[int]) -> Iterator[tuple[list[int], list[str]]]:
        """The sets of views to encode, each with the settings that use it. ``order``: cameras, the
        last the query.
        """
        if self.solids is None:
            left = list(order)
            for name, count in self.cfg.train_draws.items():
                for _ in range(count):
                    views = self._views(self.settings[name], left)
                    left = [*left[len(views) :], *views]
                    yield views, [name]
            return
        shared: dict[int | str, list[str]] = {}
        for name, setting in self.settings.items():
            shared.setdefault(setting.views, []).append(name)
        for names in shared.values():
            yield self._views(self.settings[names[0]], order), names

    def _views(self, setting: Setting, order: Sequence[int]) -> list[int]:
        return (
            list(order[: setting.views])
            if isinstance(setting.views, int)
            else [self.cfg.fixed_camera]
        )

    def _boxes(
        self, boxes: str, scene: SceneFeatures, episode_i: int, rng: np.random.Generator
    ) -> tuple[Tensor, Tensor, Tensor, NDArray[np.int64]]:
        """Centres N3, sizes N3, scores N and the true object of each (-1: none)."""
        step = self.source.episodes[episode_i].steps[0]
        if boxes == PREDICTED:
            centers, sizes, scores = (value.float().cpu() for value in self.perceiver.detect(scene))
            return (
                centers,
                sizes,
                scores,
                match_detections(centers.double().numpy(), step.center_N3),
            )
        center_N3, size_N3 = step.center_N3, step.size_N3
        if boxes == JITTERED:
            center_N3 = center_N3 + rng.normal(0, self.cfg.center_jitter_m, center_N3.shape)
            size_N3 = size_N3 * np.exp(rng.normal(0, self.cfg.size_jitter, size_N3.shape))
        count = len(center_N3)
        centers, sizes = torch.from_numpy(center_N3).float(), torch.from_numpy(size_N3).float()
        return centers, sizes, torch.ones(count), np.arange(count)


def perceive_split(
    observer: ScenePerceiver, progress: Path
) -> tuple[dict[str, Tensor], list[PerceptionRow], list[PerceptionRow]]:
    """All draws of a split, packed, and its rows. Finished shards of episodes are kept in
    ``progress`` and reused.
    """
    cfg, count = observer.cfg, len(observer.source.episodes)
    starts = range(0, count, cfg.shard_episodes)
    paths = [progress / f"shard_{start:06d}.safetensors" for start in starts]
    shards = [
        (range(s, min(s + cfg.shard_episodes, count)), path)
        for s, path in zip(starts, paths, strict=True)
    ]
    jobs = [delayed(_write_shard)(observer, *shard) for shard in shards if not shard[1].exists()]
    num_workers = cfg.num_workers if observer.perceiver.device.type == "cpu" else 1
    done = Parallel(n_jobs=num_workers, return_as="generator_unordered")(jobs)
    for _ in tqdm(done, total=len(jobs), desc="perceiving", unit="shard"):
        pass
    rows = [json.loads(path.with_suffix(".json").read_text()) for path in paths]
    tensors = joined([load_file(path) for path in paths])
    return (
        tensors,
        [row for detections, _ in rows for row in detections],
        [row for _, views in rows for row in views],
    )


def _write_shard(observer: ScenePerceiver, episode_is: range, path: Path) -> None:
    """One shard: the rows first, then the tensors, whole by rename: a shard with tensors is
    complete.
    """
    found = [observer.episode(episode_i) for episode_i in episode_is]
    rows = [[row for parts in found for row in parts[kind]] for kind in (1, 2)]
    path.with_suffix(".json").write_text(json.dumps(rows))
    draws = [draw for parts in found for draw in parts[0]]
    most = max(
        setting.views for setting in observer.settings.values() if isinstance(setting.views, int)
    )
    write_tensors(pack(draws, list(observer.settings), most), path, {})
