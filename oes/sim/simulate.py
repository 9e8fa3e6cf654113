"""One pushing episode in Bullet, drawn from its place in the dataset; and its re-run with other mass and friction."""

import zlib
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from oes.config import params
from oes.episode import Body, Camera, Episode, Floats, Step
from oes.sim.arm import ReachError
from oes.sim.rig import rig
from oes.sim.scene import Pushes, Rejected, draw_action, draw_heading, draw_start
from oes.sim.world import NS_PER_MS, Sim, World

if TYPE_CHECKING:
    from oes.meshes.catalogue import Catalogue

TASKS = ("pushing",)


@params
class Split:
    """How many episodes, with how many objects each (the number is drawn uniformly)."""

    count: int
    min_objects: int
    max_objects: int


@params
class Sheets:
    """The pages about a split: which camera its pictures come from, how many episodes get a contact sheet."""

    camera: int
    count: int


@params
class Episodes:
    """The section ``episodes`` of params.yaml."""

    seed: int
    num_workers: int
    sim: Sim
    pushes: Pushes
    splits: dict[str, Split]
    sheets: Sheets


def simulate(catalogue: "Catalogue", cfg: Episodes, task: str, split: str, index: int) -> Episode:
    """Episode ``index`` of a split: the first attempt that is not rejected. Same arguments, same bytes.

    The split ``train`` uses the catalogue's training meshes, every other split its test meshes (paper appendix B).
    Raises KeyError for an unknown split, ValueError for an unknown task, Rejected when no attempt succeeds.
    """
    if task not in TASKS:
        raise ValueError(f"unknown task {task!r}; there are: {', '.join(TASKS)}")
    reasons = []
    with World(catalogue, cfg.sim) as world:
        for attempt in range(cfg.pushes.max_attempts):
            seed = attempt_seed(cfg.seed, task, split, index, attempt)
            try:
                return _attempt(world, cfg, task, split, index, seed)
            except (Rejected, ReachError) as error:
                reasons.append(str(error))
    raise Rejected(f"{task}-{split} {index}: {len(reasons)} attempts failed; the last: {reasons[-1]}")


def attempt_seed(seed: int, task: str, split: str, index: int, attempt: int) -> int:
    """The seed (32 bits) of one attempt at one episode; ``Episode.seed`` is that of the attempt that succeeded."""
    words = [seed, zlib.crc32(task.encode()), zlib.crc32(split.encode()), index, attempt]
    return int(np.random.SeedSequence(words).generate_state(1)[0])


def count_rejected(episode: Episode, cfg: Episodes) -> int:
    """How many attempts were rejected before this episode's, which its seed tells."""
    for attempt in range(cfg.pushes.max_attempts):
        if attempt_seed(cfg.seed, episode.task, episode.split, episode.index, attempt) == episode.seed:
            return attempt
    raise ValueError(f"episode {episode.index} has a seed that these params do not give")


def replay(catalogue: "Catalogue", cfg: Sim, episode: Episode, mass_kg: float, friction: float) -> Episode:
    """The same start and actions, every body with this mass and friction: what Bullet foresees without knowing them."""
    bodies = tuple(replace(body, mass_kg=mass_kg, friction=friction) for body in episode.bodies)
    return replay_bodies(catalogue, cfg, episode, bodies)


def replay_bodies(catalogue: "Catalogue", cfg: Sim, episode: Episode, bodies: tuple[Body, ...]) -> Episode:
    """The episode's start and actions with these bodies in place of its own; its cameras are kept."""
    first = episode.steps[0]
    with World(catalogue, cfg) as world:
        world.reset(bodies, first.world_T_obj_N44, first.tip_world_3)
        steps, squares = [world.step(0, first.cameras)], []
        for action_3, old in zip(episode.actions_T3, episode.steps[1:], strict=True):
            squares.append(world.push(action_3))
            steps.append(_record(world, len(steps), old.cameras))
    return replace(episode, bodies=bodies, steps=tuple(steps), rod_rms_m=_rms(squares))


def _attempt(world: World, cfg: Episodes, task: str, split: str, index: int, seed: int) -> Episode:
    """One attempt, all of it drawn from ``seed``. Raises Rejected or ReachError."""
    rng, camera_rng = (np.random.default_rng([seed, stream]) for stream in range(2))
    counts = cfg.splits[split]
    meshes = world.catalogue.split("train" if split == "train" else "test")
    num_objects = int(rng.integers(counts.min_objects, counts.max_objects + 1))
    start = draw_start(meshes, num_objects, cfg.sim.bodies, cfg.sim.robot, cfg.pushes, rng)
    world.reset(start.bodies, settle(world, start.bodies, start.world_T_obj_N44, cfg.pushes), start.tip_world_3)
    steps, actions, squares = [world.step(0, rig(cfg.sim.rig, camera_rng))], [], []
    heading_rad = start.heading_rad
    for action_i in range(cfg.pushes.num_actions):
        if action_i > 0:
            heading_rad = draw_heading(steps[-1].tip_world_3, steps[-1].center_N3[0], heading_rad, cfg.pushes, rng)
        actions.append(draw_action(heading_rad, cfg.pushes, rng))
        squares.append(world.push(actions[-1]))
        steps.append(_record(world, len(steps), rig(cfg.sim.rig, camera_rng)))
        _check_stands(steps[-1], steps[0], cfg)
    return Episode(task, split, index, seed, start.bodies, np.array(actions), tuple(steps), _rms(squares))


def settle(world: World, bodies: tuple[Body, ...], world_T_obj_N44: Floats, cfg: Pushes) -> Floats:
    """Poses N44 after the bodies came to rest on the table, no arm about. Raises Rejected where one tips or wanders."""
    world.reset(bodies, world_T_obj_N44, None)
    world.run(cfg.settle_ms)
    poses = world.poses()
    shift = np.linalg.norm(poses[:, :3, 3] - world_T_obj_N44[:, :3, 3], axis=1)
    if (tilt_deg(poses, world_T_obj_N44) > cfg.settle_tilt_deg).any() or (shift > cfg.settle_shift_m).any():
        raise Rejected("an object does not stand still where it is put")
    return poses


def tilt_deg(world_T_obj_N44: Floats, start_N44: Floats) -> Floats:
    """Angle N between each object's vertical at the start and where that axis points now."""
    cosine = (world_T_obj_N44[:, :3, 2] * start_N44[:, :3, 2]).sum(axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def _record(world: World, step_i: int, cameras: tuple[Camera, ...]) -> Step:
    """The state after action ``step_i``, with the contacts since the one before."""
    step = world.step(step_i * world.cfg.physics.timestep_ms * NS_PER_MS, cameras)
    world.clear_contacts()
    return step


def _check_stands(step: Step, first: Step, cfg: Episodes) -> None:
    """Raises Rejected where an object has left the table or toppled."""
    half_x, half_y, _ = np.array(cfg.sim.physics.table_size_m) / 2
    x, y, z = step.world_T_obj_N44[:, :3, 3].T
    if (np.abs(x) > half_x).any() or (np.abs(y) > half_y).any() or (z < 0).any():
        raise Rejected("an object left the table")
    if (tilt_deg(step.world_T_obj_N44, first.world_T_obj_N44) > cfg.pushes.topple_deg).any():
        raise Rejected("an object toppled")


def _rms(squares: Sequence[Floats]) -> float:
    return float(np.sqrt(np.concatenate(squares).mean()))
