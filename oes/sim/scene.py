"""Random pushing scenes: objects on the table, the start of the rod, and the headings of pushes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from oes.config import params
from oes.episode import Body, Floats
from oes.geom.boxes import aabb
from oes.meshes.catalogue import Mesh
from oes.sim.bodies import BodiesConfig, body_footprint, draw_body, upright
from oes.sim.robot import RobotConfig

MARCH_STEP_M = 0.001  # resolution of the search for the rod's first contact with a footprint
MARCH_START_M = 0.25  # longer than any object, so that the search starts in free space
MAX_PLACEMENTS = 30  # poses tried for an object before the scene is rejected


@params
class ScatterConfig:
    """Free placement: centres in +- ``spread_m``, footprints in +- ``table_edge_m``, ``gap_m``
    apart.
    """

    spread_m: float
    table_edge_m: float
    gap_m: float


@params
class PushesConfig:
    """Random pushes of the first object, with others in its way.

    ``path_center_m``: largest |x| and |y| of the centre of the intended path.
    ``lead_in_m``: distance of the pushed object before that centre.
    ``clearance_m``: range of the initial gap between rod and footprint.
    ``max_offset``: largest lateral offset of the rod from the object's centre, in half widths.
    ``blocker_prob``: probability that a further object blocks the path; else it stands anywhere.
    ``blocker_gap_m``: range of the gap between the pushed object and a blocker.
    ``blocker_lateral_m``: largest lateral offset of a blocker.
    ``length_m``: range of the length of one action.
    ``recenter_gain``: share of the angle to the pushed object by which each action turns.
    ``heading_noise_deg``: standard deviation of the heading.
    ``topple_deg``: largest tilt; an episode with more is rejected.
    """

    num_actions: int
    scatter: ScatterConfig
    path_center_m: float
    lead_in_m: float
    clearance_m: tuple[float, float]
    max_offset: float
    blocker_prob: float
    blocker_gap_m: tuple[float, float]
    blocker_lateral_m: float
    length_m: tuple[float, float]
    recenter_gain: float
    heading_noise_deg: float
    topple_deg: float


class SceneRejected(Exception):
    """An attempt at a scene or an episode failed; the message is the reason."""


@dataclass(frozen=True)
class PushScene:
    """A scene before the first push: upright bodies, the rod's tip and the first heading."""

    bodies: tuple[Body, ...]
    world_T_obj_N44: Floats
    tip_world_3: Floats
    heading_rad: float


def draw_scene(
    meshes: Sequence[Mesh],
    num_objects: int,
    bodies_cfg: BodiesConfig,
    robot: RobotConfig,
    cfg: PushesConfig,
    rng: np.random.Generator,
) -> PushScene:
    """A random pushing scene (paper appendix B). Raises SceneRejected."""
    chosen = draw_meshes(meshes, num_objects, rng)
    bodies = [draw_body(mesh, bodies_cfg, rng) for mesh in chosen]
    heading_rad = rng.uniform(-np.pi, np.pi)
    forward = _direction(heading_rad)
    pushed_xy = rng.uniform(-cfg.path_center_m, cfg.path_center_m, 2) - cfg.lead_in_m * forward
    poses = [upright(chosen[0], bodies[0], pushed_xy, rng.uniform(-np.pi, np.pi))]
    pushed = body_footprint(chosen[0], bodies[0], poses[0])
    tip_xy = _rod_start(pushed, pushed_xy, forward, cfg, robot.rod_radius_m, rng)
    occupied = [pushed, shapely.Point(tip_xy).buffer(robot.rod_radius_m)]
    for mesh, body in zip(chosen[1:], bodies[1:], strict=True):
        pose, footprint = _place_next(mesh, body, pushed_xy, forward, occupied, cfg, rng)
        poses.append(pose)
        occupied.append(footprint)
    tip_3 = np.array([*tip_xy, robot.tip_height_m])
    return PushScene(tuple(bodies), np.array(poses), tip_3, float(heading_rad))


def draw_meshes(meshes: Sequence[Mesh], num_objects: int, rng: np.random.Generator) -> list[Mesh]:
    """Random meshes, with repetition only if there are fewer than ``num_objects``.

    Raises ValueError without meshes.
    """
    if not meshes:
        raise ValueError("no meshes to draw from")
    chosen = rng.choice(len(meshes), num_objects, replace=num_objects > len(meshes))
    return [meshes[i] for i in chosen]


def scatter(
    meshes: Sequence[Mesh], bodies: Sequence[Body], cfg: ScatterConfig, rng: np.random.Generator
) -> Floats:
    """Random upright poses N44 without overlap. Raises SceneRejected if the bodies do not fit."""
    poses: list[Floats] = []
    footprints: list[shapely.Geometry] = []
    for mesh, body in zip(meshes, bodies, strict=True):
        for _ in range(MAX_PLACEMENTS):
            xy = rng.uniform(-cfg.spread_m, cfg.spread_m, 2)
            pose = upright(mesh, body, xy, rng.uniform(-np.pi, np.pi))
            footprint = body_footprint(mesh, body, pose)
            if is_free(footprint, footprints, cfg):
                poses.append(pose)
                footprints.append(footprint)
                break
        else:
            raise SceneRejected("no room for an object")
    return np.array(poses).reshape(-1, 4, 4)


def is_free(
    footprint: shapely.Geometry, others: Sequence[shapely.Geometry], cfg: ScatterConfig
) -> bool:
    """Whether a footprint lies on the table and at least ``gap_m`` from the others."""
    edge_m = cfg.table_edge_m
    return bool(shapely.box(-edge_m, -edge_m, edge_m, edge_m).contains(footprint)) and all(
        footprint.distance(other) >= cfg.gap_m for other in others
    )


def draw_heading(
    tip_3: Floats, target_3: Floats, heading_rad: float, cfg: PushesConfig, rng: np.random.Generator
) -> float:
    """The next heading: the last one, turned part of the way to the target, plus normal noise."""
    to_target = np.arctan2(target_3[1] - tip_3[1], target_3[0] - tip_3[0])
    turn = (to_target - heading_rad + np.pi) % (2 * np.pi) - np.pi
    noise = np.radians(cfg.heading_noise_deg) * rng.normal()
    return float(heading_rad + cfg.recenter_gain * turn + noise)


def draw_action(heading_rad: float, cfg: PushesConfig, rng: np.random.Generator) -> Floats:
    """A horizontal displacement (3) of the rod along ``heading_rad``, of random length."""
    return np.array([*(rng.uniform(*cfg.length_m) * _direction(heading_rad)), 0.0])


def _direction(angle_rad: float) -> Floats:
    return np.array([np.cos(angle_rad), np.sin(angle_rad)])


def _rod_start(
    footprint: shapely.Geometry,
    center_xy: Floats,
    forward: Floats,
    cfg: PushesConfig,
    rod_radius_m: float,
    rng: np.random.Generator,
) -> Floats:
    """Position of the tip (2) at the drawn clearance before the footprint along ``forward``."""
    side = np.array([-forward[1], forward[0]])
    across = (shapely.get_coordinates(footprint) - center_xy) @ side
    offset = rng.uniform(-cfg.max_offset, cfg.max_offset) * (across.max() - across.min()) / 2
    # Marching along the line finds the start for any footprint, convex or not.
    distances = np.arange(MARCH_START_M, 0.0, -MARCH_STEP_M)
    line = center_xy + offset * side - distances[:, None] * forward
    limit_m = rod_radius_m + rng.uniform(*cfg.clearance_m)
    is_near = shapely.distance(shapely.points(line), footprint) < limit_m
    if not is_near.any() or is_near[0]:
        raise SceneRejected("the rod's line misses the object")
    return np.asarray(line[int(np.argmax(is_near)) - 1])


def _place_next(
    mesh: Mesh,
    body: Body,
    pushed_xy: Floats,
    forward: Floats,
    occupied: Sequence[shapely.Geometry],
    cfg: PushesConfig,
    rng: np.random.Generator,
) -> tuple[Floats, shapely.Geometry]:
    """Pose and footprint of a further object: a blocker of the path, or anywhere free."""
    side = np.array([-forward[1], forward[0]])
    is_blocker = rng.random() < cfg.blocker_prob
    for _ in range(MAX_PLACEMENTS):
        yaw_rad = rng.uniform(-np.pi, np.pi)
        # Drawn for blockers too, so that both cases consume the same random numbers.
        xy = rng.uniform(-cfg.scatter.spread_m, cfg.scatter.spread_m, 2)
        if is_blocker:
            front = ((shapely.get_coordinates(occupied[0]) - pushed_xy) @ forward).max()
            # The mean horizontal side approximates the width at any yaw.
            half_width = aabb(mesh.visual.vertices * body.scale_3)[1][:2].mean() / 2
            beyond = (
                pushed_xy + (float(front) + half_width + rng.uniform(*cfg.blocker_gap_m)) * forward
            )
            xy = beyond + rng.uniform(-cfg.blocker_lateral_m, cfg.blocker_lateral_m) * side
        pose = upright(mesh, body, xy, yaw_rad)
        footprint = body_footprint(mesh, body, pose)
        if is_free(footprint, occupied, cfg.scatter):
            return pose, footprint
    raise SceneRejected("no room for an object")
