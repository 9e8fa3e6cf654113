"""Capture of episodes: simulate, render 27 cameras at every state, record."""

import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from oes.episode import Episode
from oes.meshes.catalogue import Catalogue, load_catalogue
from oes.progress import progress_bar
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
    """An episode that could not be made, and the reason."""

    index: int
    reason: str


def capture_split(
    meshes: Path, cfg: EpisodesConfig, task: str, split: str, work: Path
) -> list[Failure]:
    """Capture the episodes of a split that ``work`` lacks, in ``cfg.num_workers`` processes.

    Returns the episodes that failed, which are left out. Raises KeyError for an unknown split.
    """
    indices = range(cfg.splits[task][split].count)
    missing = [i for i in indices if not episode_folder(work, i).exists()]
    # Every episode is written by rename (write_episode), so that one that exists is whole.
    jobs = [delayed(_try_capture)(meshes, cfg, task, split, i, work) for i in missing]
    done = Parallel(n_jobs=cfg.num_workers, return_as="generator_unordered")(jobs)
    bar = progress_bar(done, total=len(missing), desc=f"{task}-{split}", unit="episode")
    failures = sorted(filter(None, bar), key=lambda failure: failure.index)
    for failure in failures:
        log.warning("%s-%s %d left out: %s", task, split, failure.index, failure.reason)
    return failures


def capture(
    catalogue: Catalogue, cfg: EpisodesConfig, task: str, split: str, index: int, folder: Path
) -> None:
    """Simulate, render and record one episode as ``folder``, which appears whole."""
    episode = simulate(catalogue, cfg, task, split, index)
    renderer = scene_renderer(episode, catalogue, cfg.sim)
    frames = (renderer.render(mesh_poses(step), step.cameras) for step in episode.steps)
    write_episode(episode, frames, folder)


def episode_folder(work: Path, index: int) -> Path:
    """Folder of episode ``index`` of a split."""
    return work / f"traj_{index:06d}"


def scene_renderer(episode: Episode, catalogue: Catalogue, cfg: SimConfig) -> Renderer:
    """Renderer of an episode's table, arm (if any) and objects; its poses: ``mesh_poses(step)``."""
    table = np.array(cfg.physics.table_size_m)
    robot = robot_shape(cfg.robot) if episode.has_robot else RobotShape(())
    return Renderer(scene_meshes(table, robot, episode.bodies, catalogue))


def _try_capture(
    meshes: Path, cfg: EpisodesConfig, task: str, split: str, index: int, work: Path
) -> Failure | None:
    try:
        capture(_catalogue(meshes), cfg, task, split, index, episode_folder(work, index))
    except (SceneRejected, BulletError, ValueError) as error:
        return Failure(index, f"{type(error).__name__}: {error}")
    return None


@lru_cache(maxsize=1)
def _catalogue(folder: Path) -> Catalogue:
    """The catalogue, loaded once a worker process."""
    return load_catalogue(folder)
