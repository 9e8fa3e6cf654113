"""Capture: an episode is simulated, seen by 27 cameras at every state, and written; a split is many
at once.
"""

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from tqdm import tqdm

from oes.episode import Episode
from oes.meshes.catalogue import Catalogue, load_catalogue
from oes.record.writer import write_episode
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses, scene_meshes
from oes.sim.client import BulletError
from oes.sim.robot import RobotShape, robot_shape
from oes.sim.scene import SceneRejected
from oes.sim.simulate import EpisodesConfig, simulate
from oes.sim.world import SimConfig

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Failure:
    """An episode that could not be made, and why."""

    index: int
    reason: str


def capture_split(
    meshes: Path, cfg: EpisodesConfig, task: str, split: str, work: Path
) -> list[Failure]:
    """Simulate, render and record all episodes of a split into ``work``, on all cores; those there
    already are kept.

    An episode that fails is left out and returned with its reason. Raises KeyError for an unknown
    split.
    """
    missing = [
        i for i in range(cfg.splits[task][split].count) if not episode_folder(work, i).exists()
    ]
    jobs = (delayed(_try_capture)(meshes, cfg, task, split, i, work) for i in missing)
    done = Parallel(n_jobs=cfg.num_workers, return_as="generator_unordered")(jobs)
    bar = tqdm(done, total=len(missing), desc=f"{task}-{split}", unit="episode")
    failures = [outcome for outcome in bar if outcome is not None]
    for failure in failures:
        log.warning("%s-%s %d left out: %s", task, split, failure.index, failure.reason)
    return sorted(failures, key=lambda failure: failure.index)


def capture(
    catalogue: Catalogue, cfg: EpisodesConfig, task: str, split: str, index: int, folder: Path
) -> None:
    """Make one episode, and its images, as ``folder``, which appears whole."""
    write(simulate(catalogue, cfg, task, split, index), catalogue, cfg, folder)


def write(episode: Episode, catalogue: Catalogue, cfg: EpisodesConfig, folder: Path) -> None:
    """Render all cameras of every state of an episode and record it as ``folder``."""
    renderer = scene_renderer(episode, catalogue, cfg.sim)
    frames = (renderer.render(mesh_poses(step), step.cameras) for step in episode.steps)
    write_episode(episode, frames, folder)


def episode_folder(work: Path, index: int) -> Path:
    """Where episode ``index`` of a split lies."""
    return work / f"traj_{index:06d}"


def scene_renderer(episode: Episode, catalogue: Catalogue, cfg: SimConfig) -> Renderer:
    """The renderer of an episode's table, arm (if any) and bodies; ``mesh_poses(step)`` gives its
    poses.
    """
    table = np.array(cfg.physics.table_size_m)
    robot = robot_shape(cfg.robot) if episode.has_robot else RobotShape(())
    return Renderer(scene_meshes(table, robot, episode.bodies, catalogue))


def _try_capture(
    meshes: Path, cfg: EpisodesConfig, task: str, split: str, index: int, work: Path
) -> Failure | None:
    """One job of a worker process, which keeps its catalogue from job to job."""
    try:
        capture(_catalogue(meshes), cfg, task, split, index, episode_folder(work, index))
    except (SceneRejected, BulletError, ValueError) as error:
        return Failure(index, f"{type(error).__name__}: {error}")
    return None


@lru_cache(maxsize=1)
def _catalogue(folder: Path) -> Catalogue:
    return load_catalogue(folder)
