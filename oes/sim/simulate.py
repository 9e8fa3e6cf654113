"""Simulation of one episode, determined by its place in the dataset, and replays of it."""

import zlib
from dataclasses import replace

import numpy as np

from oes.config import Shared, params
from oes.episode import PUSHING, TASKS, Body, Episode
from oes.meshes.catalogue import Catalogue
from oes.sim.arm import ReachError
from oes.sim.attempt import EpisodeSampler, SettleConfig, attempt_drop, attempt_push, record, rms
from oes.sim.drop import FallsConfig
from oes.sim.scene import PushesConfig, SceneRejected
from oes.sim.world import NS_PER_MS, SimConfig, World


@params
class SplitConfig:
    """Number of episodes, and range of the uniform number of objects (the falling one counts)."""

    count: int
    min_objects: int
    max_objects: int


@params
class SheetsConfig:
    """Contact sheets of a split: the index of their camera, and how many episodes have one."""

    camera: int
    count: int


@params
class EpisodesConfig:
    """The section ``episodes`` of params.yaml; ``splits`` are by task, then by name."""

    seed: int
    num_workers: int
    max_attempts: int
    sim: Shared[SimConfig]
    settle: SettleConfig
    pushes: PushesConfig
    falls: FallsConfig
    splits: dict[str, dict[str, SplitConfig]]
    sheets: SheetsConfig

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from a file) unless every task has splits."""
        if set(self.splits) != set(TASKS):
            expected, found = ", ".join(TASKS), ", ".join(self.splits)
            raise ValueError(f"splits: expected exactly {expected}; found {found}")


def simulate(
    catalogue: Catalogue, cfg: EpisodesConfig, task: str, split: str, index: int
) -> Episode:
    """Episode ``index`` of a split: the first attempt that is not rejected; deterministic.

    Split ``train`` uses the catalogue's training meshes, every other split its test meshes (paper
    appendix B). Raises ValueError for an unknown task, KeyError for an unknown split, SceneRejected
    after ``cfg.max_attempts`` rejected attempts.
    """
    if task not in TASKS:
        raise ValueError(f"unknown task {task!r}; there are: {', '.join(TASKS)}")
    reasons = []
    with World(catalogue, cfg.sim) as world:
        for attempt in range(cfg.max_attempts):
            seed = attempt_seed(cfg.seed, task, split, index, attempt)
            try:
                return _attempt(world, cfg, task, split, index, seed)
            except (SceneRejected, ReachError) as error:
                reasons.append(str(error))
    raise SceneRejected(
        f"{task}-{split} {index}: {len(reasons)} attempts failed; the last: {reasons[-1]}"
    )


def attempt_seed(seed: int, task: str, split: str, index: int, attempt: int) -> int:
    """Seed (32 bits) of an attempt; ``Episode.seed`` is that of the successful one."""
    # CRC-32, as Python's own hash of a string differs between processes.
    entropy = [seed, zlib.crc32(task.encode()), zlib.crc32(split.encode()), index, attempt]
    return int(np.random.SeedSequence(entropy).generate_state(1)[0])


def count_rejected(episode: Episode, cfg: EpisodesConfig) -> int:
    """Number of attempts rejected before the episode's, found by its seed.

    Raises ValueError if no attempt under ``cfg`` has that seed.
    """
    for attempt in range(cfg.max_attempts):
        seed = attempt_seed(cfg.seed, episode.task, episode.split, episode.index, attempt)
        if seed == episode.seed:
            return attempt
    raise ValueError(f"episode {episode.index} has a seed that these params do not give")


def replay(
    catalogue: Catalogue, cfg: SimConfig, episode: Episode, mass_kg: float, friction: float
) -> Episode:
    """The same start and actions with one mass and friction for all bodies: Bullet's forecast when
    it does not know them.
    """
    bodies = tuple(replace(body, mass_kg=mass_kg, friction=friction) for body in episode.bodies)
    return replay_bodies(catalogue, cfg, episode, bodies)


def replay_bodies(
    catalogue: Catalogue, cfg: SimConfig, episode: Episode, bodies: tuple[Body, ...]
) -> Episode:
    """The same start, actions, cameras and times with other bodies."""
    first = episode.steps[0]
    with World(catalogue, cfg) as world:
        world.reset(bodies, first.world_T_obj_N44, first.tip_world_3 if episode.has_robot else None)
        steps, squares = [world.step(first.t_ns, first.cameras)], []
        for action_3, old in zip(episode.actions_T3, episode.steps[1:], strict=True):
            if episode.has_robot:
                squares.append(world.push(action_3))
            else:
                world.run((old.t_ns - steps[-1].t_ns) // NS_PER_MS)
            steps.append(record(world, old.t_ns, old.cameras))
    rod_rms_m = rms(squares) if squares else np.nan
    return replace(episode, bodies=bodies, steps=tuple(steps), rod_rms_m=rod_rms_m)


def _attempt(
    world: World, cfg: EpisodesConfig, task: str, split: str, index: int, seed: int
) -> Episode:
    rng, camera_rng = (np.random.default_rng([seed, stream]) for stream in range(2))
    counts = cfg.splits[task][split]
    meshes = world.catalogue.split("train" if split == "train" else "test", task)
    num_objects = int(rng.integers(counts.min_objects, counts.max_objects + 1))
    sampler = EpisodeSampler(world, meshes, num_objects, rng, camera_rng)
    if task == PUSHING:
        found = attempt_push(sampler, cfg.pushes, cfg.settle)
    else:
        found = attempt_drop(sampler, cfg.falls, cfg.settle)
    return Episode(task, split, index, seed, *vars(found).values())
