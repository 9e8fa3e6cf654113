"""One attempt at an episode of each task: a scene drawn, put to rest, set in motion and
recorded.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oes.config import params
from oes.episode import Body, Camera, Floats, Step
from oes.sim.bodies import draw_body
from oes.sim.drop import FallsConfig, draw_drop
from oes.sim.rig import rig
from oes.sim.scene import (
    PushesConfig,
    SceneRejected,
    draw_action,
    draw_heading,
    draw_meshes,
    draw_start,
    scatter,
)
from oes.sim.world import NS_PER_MS, World

if TYPE_CHECKING:
    from oes.meshes.catalogue import Mesh


@params
class SettleConfig:
    """How long standing objects rest before the first state, and how far one may tilt and wander
    meanwhile.
    """

    time_ms: int
    tilt_deg: float
    shift_m: float


@dataclass(frozen=True)
class EpisodeSampler:
    """What an attempt draws from: a world, meshes, the number of objects, and two streams of random
    numbers.
    """

    world: World
    meshes: Sequence["Mesh"]
    num_objects: int
    rng: np.random.Generator
    camera_rng: np.random.Generator

    def cameras(self) -> tuple[Camera, ...]:
        """A freshly perturbed rig."""
        return rig(self.world.cfg.rig, self.camera_rng)


@dataclass(frozen=True)
class Trajectory:
    """What came of it, as in ``oes.episode.Episode``."""

    bodies: tuple[Body, ...]
    actions_T3: Floats
    steps: tuple[Step, ...]
    rod_rms_m: float


def attempt_push(chance: EpisodeSampler, cfg: PushesConfig, rest: SettleConfig) -> Trajectory:
    """Objects pushed by the rod. Raises Rejected or ReachError."""
    world, rng = chance.world, chance.rng
    start = draw_start(
        chance.meshes, chance.num_objects, world.cfg.bodies, world.cfg.robot, cfg, rng
    )
    world.reset(
        start.bodies, settle(world, start.bodies, start.world_T_obj_N44, rest), start.tip_world_3
    )
    steps, actions, squares = [world.step(0, chance.cameras())], [], []
    heading_rad = start.heading_rad
    for action_i in range(cfg.num_actions):
        if action_i > 0:
            heading_rad = draw_heading(
                steps[-1].tip_world_3, steps[-1].center_N3[0], heading_rad, cfg, rng
            )
        actions.append(draw_action(heading_rad, cfg, rng))
        squares.append(world.push(actions[-1]))
        steps.append(
            record(world, len(steps) * world.cfg.physics.timestep_ms * NS_PER_MS, chance.cameras())
        )
        _check_on_table(steps[-1], world)
        if (tilt_deg(steps[-1].world_T_obj_N44, steps[0].world_T_obj_N44) > cfg.topple_deg).any():
            raise SceneRejected("an object toppled")
    return Trajectory(start.bodies, np.array(actions), tuple(steps), rms(squares))


def attempt_drop(chance: EpisodeSampler, cfg: FallsConfig, rest: SettleConfig) -> Trajectory:
    """Objects on the table, the last one falling onto or beside them, no robot. Raises Rejected."""
    world, rng = chance.world, chance.rng
    meshes = draw_meshes(chance.meshes, chance.num_objects, rng)
    bodies = tuple(draw_body(mesh, world.cfg.bodies, rng) for mesh in meshes)
    placed_N44 = scatter(meshes[:-1], bodies[:-1], cfg.scatter, rng)
    standing_N44 = settle(world, bodies[:-1], placed_N44, rest)
    drop_44 = draw_drop(meshes, bodies, standing_N44, cfg, rng)
    world.reset(bodies, np.concatenate([standing_N44, drop_44[None]]), None)
    steps = [world.step(0, chance.cameras())]
    for _ in range(cfg.num_steps):
        world.run(cfg.timestep_ms)
        steps.append(record(world, len(steps) * cfg.timestep_ms * NS_PER_MS, chance.cameras()))
        _check_on_table(steps[-1], world)
    return Trajectory(bodies, np.zeros((cfg.num_steps, 3)), tuple(steps), np.nan)


def settle(
    world: World, bodies: tuple[Body, ...], world_T_obj_N44: Floats, cfg: SettleConfig
) -> Floats:
    """Poses N44 after the bodies came to rest on the table, no arm about. Raises Rejected where one
    tips or wanders.
    """
    world.reset(bodies, world_T_obj_N44, None)
    world.run(cfg.time_ms)
    poses = world.poses()
    shift = np.linalg.norm(poses[:, :3, 3] - world_T_obj_N44[:, :3, 3], axis=1)
    if (tilt_deg(poses, world_T_obj_N44) > cfg.tilt_deg).any() or (shift > cfg.shift_m).any():
        raise SceneRejected("an object does not stand still where it is put")
    return poses


def tilt_deg(world_T_obj_N44: Floats, start_N44: Floats) -> Floats:
    """Angle N between each object's vertical at the start and where that axis points now."""
    cosine = (world_T_obj_N44[:, :3, 2] * start_N44[:, :3, 2]).sum(axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def record(world: World, t_ns: int, cameras: tuple[Camera, ...]) -> Step:
    """The state now, with the contacts since the one before."""
    step = world.step(t_ns, cameras)
    world.clear_contacts()
    return step


def rms(squares: Sequence[Floats]) -> float:
    """Root of the mean of many squares."""
    return float(np.sqrt(np.concatenate(squares).mean()))


def _check_on_table(step: Step, world: World) -> None:
    """Raises Rejected where an object has left the table."""
    half_x, half_y, _ = np.array(world.cfg.physics.table_size_m) / 2
    x, y, z = step.world_T_obj_N44[:, :3, 3].T
    if (np.abs(x) > half_x).any() or (np.abs(y) > half_y).any() or (z < 0).any():
        raise SceneRejected("an object left the table")
