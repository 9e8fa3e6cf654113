"""One attempt at an episode of each task: draw a scene, let it settle, simulate, record."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oes.config import params
from oes.episode import Body, Camera, Floats, Step
from oes.meshes.catalogue import Mesh
from oes.sim.bodies import draw_body
from oes.sim.drop import FallsConfig, draw_drop
from oes.sim.rig import rig
from oes.sim.scene import (
    PushesConfig,
    SceneRejected,
    draw_action,
    draw_heading,
    draw_meshes,
    draw_scene,
    scatter,
)
from oes.sim.world import NS_PER_MS, World


@params
class SettleConfig:
    """Settling before the first state: its duration, and the largest tilt and shift of an object
    meanwhile.
    """

    time_ms: int
    max_tilt_deg: float
    max_shift_m: float


@dataclass(frozen=True)
class EpisodeSampler:
    """Source of one attempt: a world, meshes, the number of objects and two random streams.

    Cameras have a stream of their own, so that they do not change the scene.
    """

    world: World
    meshes: Sequence[Mesh]
    num_objects: int
    rng: np.random.Generator
    camera_rng: np.random.Generator

    def cameras(self) -> tuple[Camera, ...]:
        """A newly perturbed rig."""
        return rig(self.world.cfg.rig, self.camera_rng)


@dataclass(frozen=True)
class Trajectory:
    """Result of an attempt, with fields as in ``oes.episode.Episode``."""

    bodies: tuple[Body, ...]
    actions_T3: Floats
    steps: tuple[Step, ...]
    rod_rms_m: float


def attempt_push(sampler: EpisodeSampler, cfg: PushesConfig, rest: SettleConfig) -> Trajectory:
    """Objects pushed by the rod. Raises SceneRejected or ReachError."""
    world, rng = sampler.world, sampler.rng
    bodies_cfg, robot = world.cfg.bodies, world.cfg.robot
    scene = draw_scene(sampler.meshes, sampler.num_objects, bodies_cfg, robot, cfg, rng)
    poses_N44 = settle(world, scene.bodies, scene.world_T_obj_N44, rest)
    world.reset(scene.bodies, poses_N44, scene.tip_world_3)
    steps, actions, squares = [world.step(0, sampler.cameras())], [], []
    heading_rad = scene.heading_rad
    for action_i in range(cfg.num_actions):
        if action_i > 0:
            tip_3, target_3 = steps[-1].tip_world_3, steps[-1].center_N3[0]
            heading_rad = draw_heading(tip_3, target_3, heading_rad, cfg, rng)
        actions.append(draw_action(heading_rad, cfg, rng))
        squares.append(world.push(actions[-1]))
        t_ns = len(steps) * world.cfg.physics.timestep_ms * NS_PER_MS
        steps.append(record(world, t_ns, sampler.cameras()))
        _check_on_table(steps[-1], world)
        if (tilt_deg(steps[-1].world_T_obj_N44, steps[0].world_T_obj_N44) > cfg.topple_deg).any():
            raise SceneRejected("an object toppled")
    return Trajectory(scene.bodies, np.array(actions), tuple(steps), rms(squares))


def attempt_drop(sampler: EpisodeSampler, cfg: FallsConfig, rest: SettleConfig) -> Trajectory:
    """Objects on the table and the last one falling, without a robot. Raises SceneRejected."""
    world, rng = sampler.world, sampler.rng
    meshes = draw_meshes(sampler.meshes, sampler.num_objects, rng)
    bodies = tuple(draw_body(mesh, world.cfg.bodies, rng) for mesh in meshes)
    placed_N44 = scatter(meshes[:-1], bodies[:-1], cfg.scatter, rng)
    standing_N44 = settle(world, bodies[:-1], placed_N44, rest)
    drop_44 = draw_drop(meshes, bodies, standing_N44, cfg, rng)
    world.reset(bodies, np.concatenate([standing_N44, drop_44[None]]), None)
    steps = [world.step(0, sampler.cameras())]
    for _ in range(cfg.num_steps):
        world.run(cfg.timestep_ms)
        steps.append(record(world, len(steps) * cfg.timestep_ms * NS_PER_MS, sampler.cameras()))
        _check_on_table(steps[-1], world)
    return Trajectory(bodies, np.zeros((cfg.num_steps, 3)), tuple(steps), np.nan)


def settle(
    world: World, bodies: tuple[Body, ...], world_T_obj_N44: Floats, cfg: SettleConfig
) -> Floats:
    """Poses N44 after ``time_ms`` at rest without the arm. Raises SceneRejected on motion."""
    world.reset(bodies, world_T_obj_N44, None)
    world.run(cfg.time_ms)
    poses = world.poses()
    shift_m = np.linalg.norm(poses[:, :3, 3] - world_T_obj_N44[:, :3, 3], axis=1)
    tilted = tilt_deg(poses, world_T_obj_N44) > cfg.max_tilt_deg
    if tilted.any() or (shift_m > cfg.max_shift_m).any():
        raise SceneRejected("an object does not stand still where it is put")
    return poses


def tilt_deg(world_T_obj_N44: Floats, start_N44: Floats) -> Floats:
    """Angle N between the z axes of each object now and at the start."""
    cosine = (world_T_obj_N44[:, :3, 2] * start_N44[:, :3, 2]).sum(axis=1)
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def record(world: World, t_ns: int, cameras: tuple[Camera, ...]) -> Step:
    """The current state, with all contacts since the previous one."""
    step = world.step(t_ns, cameras)
    world.clear_contacts()
    return step


def rms(squares: Sequence[Floats]) -> float:
    """Root mean square, from arrays of squares."""
    return float(np.sqrt(np.concatenate(squares).mean()))


def _check_on_table(step: Step, world: World) -> None:
    half_x, half_y, _ = np.array(world.cfg.physics.table_size_m) / 2
    x, y, z = step.world_T_obj_N44[:, :3, 3].T
    if (np.abs(x) > half_x).any() or (np.abs(y) > half_y).any() or (z < 0).any():
        raise SceneRejected("an object left the table")
