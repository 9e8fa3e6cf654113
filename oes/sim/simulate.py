"""One episode in Bullet, drawn from its place in the dataset; and its re-run with other mass and
friction.
"""

import zlib
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from oes.config import Shared, params
from oes.episode import FALLING, PUSHING, Body, Episode
from oes.sim.arm import ReachError
from oes.sim.attempt import EpisodeSampler, SettleConfig, attempt_drop, attempt_push, record, rms
from oes.sim.drop import FallsConfig
from oes.sim.scene import PushesConfig, SceneRejected
from oes.sim.world import NS_PER_MS, SimConfig, World

if TYPE_CHECKING:
    from oes.meshes.catalogue import Catalogue

TASKS = (PUSHING, FALLING)


@params
class SplitConfig:
    """How many episodes, with how many objects each (the number is drawn uniformly; the falling one
    counts).
    """

    count: int
    min_objects: int
    max_objects: int


@params
class SheetsConfig:
    """The pages about a split: which camera its pictures come from, how many episodes get a contact
    sheet.
    """

    camera: int
    count: int


@params
class EpisodesConfig:
    """The section ``episodes`` of params.yaml; ``splits`` by task."""

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
        """Raises ValueError (a ParamsError when read from params.yaml) for an unknown or missing
        task.
        """
        if set(self.splits) != set(TASKS):
            raise ValueError(
                f"splits: expected exactly {', '.join(TASKS)}; found {', '.join(self.splits)}"
            )


def simulate(
    catalogue: "Catalogue", cfg: EpisodesConfig, task: str, split: str, index: int
) -> Episode:
    """Episode ``index`` of a split: the first attempt that is not rejected. Same arguments, same
    bytes.

    The split ``train`` uses the catalogue's training meshes, every other split its test meshes
    (paper appendix B). Raises KeyError for an unknown split, ValueError for an unknown task,
    Rejected when no attempt succeeds.
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
    """The seed (32 bits) of one attempt at one episode; ``Episode.seed`` is that of the attempt
    that succeeded.
    """
    words = [seed, zlib.crc32(task.encode()), zlib.crc32(split.encode()), index, attempt]
    return int(np.random.SeedSequence(words).generate_state(1)[0])


def count_rejected(episode: Episode, cfg: EpisodesConfig) -> int:
    """How many attempts were rejected before this episode's, which its seed tells."""
    for attempt in range(cfg.max_attempts):
        if (
            attempt_seed(cfg.seed, episode.task, episode.split, episode.index, attempt)
            == episode.seed
        ):
            return attempt
    raise ValueError(f"episode {episode.index} has a seed that these params do not give")


def replay(
    catalogue: "Catalogue", cfg: SimConfig, episode: Episode, mass_kg: float, friction: float
) -> Episode:
    """The same start and actions, every body with this mass and friction: what Bullet foresees
    without knowing them.
    """
    bodies = tuple(replace(body, mass_kg=mass_kg, friction=friction) for body in episode.bodies)
    return replay_bodies(catalogue, cfg, episode, bodies)


def replay_bodies(
    catalogue: "Catalogue", cfg: SimConfig, episode: Episode, bodies: tuple[Body, ...]
) -> Episode:
    """The episode's start and actions with these bodies in place of its own; its cameras and times
    are kept.
    """
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
    return replace(
        episode, bodies=bodies, steps=tuple(steps), rod_rms_m=rms(squares) if squares else np.nan
    )


def _attempt(
    world: World, cfg: EpisodesConfig, task: str, split: str, index: int, seed: int
) -> Episode:
    """One attempt, all of it drawn from ``seed``. Raises Rejected or ReachError."""
    rng, camera_rng = (np.random.default_rng([seed, stream]) for stream in range(2))
    counts = cfg.splits[task][split]
    meshes = world.catalogue.split("train" if split == "train" else "test", task)
    num_objects = int(rng.integers(counts.min_objects, counts.max_objects + 1))
    chance = EpisodeSampler(world, meshes, num_objects, rng, camera_rng)
    if task == PUSHING:
        found = attempt_push(chance, cfg.pushes, cfg.settle)
    else:
        found = attempt_drop(chance, cfg.falls, cfg.settle)
    return Episode(
        task, split, index, seed, found.bodies, found.actions_T3, found.steps, found.rod_rms_m
    )
