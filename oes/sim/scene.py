"""Random pushing scenes: which objects stand where, where the rod starts, and which way each action
goes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely

from oes.config import params
from oes.episode import Body, Floats
from oes.geom.boxes import aabb
from oes.sim.bodies import BodiesConfig, body_footprint, draw_body, upright
from oes.sim.robot import RobotConfig

if TYPE_CHECKING:
    from oes.meshes.catalogue import Mesh

MARCH_M = 0.001  # how finely the rod's first contact with an outline is searched
MARCH_FROM_M = 0.25  # from how far away
TRIES = 30  # places tried for each further object before the scene is given up


@params
class ScatterConfig:
    """Where objects may stand: centres in +- ``spread_m``, outlines inside the table by ``rim_m``,
    ``gap_m`` apart.
    """

    spread_m: float
    rim_m: float
    gap_m: float


@params
class PushesConfig:
    """How a scene is built around its first object, and how its five pushes go.

    The pushed object stands ``lead_m`` before the middle of the intended path, that middle within
    +- ``middle_m`` of the table's centre. The rod starts ``clearance_m`` (range) from its outline,
    aimed past its centre by up to ``aim`` times half its width. Every further object stands in the
    way (a gap of ``ahead_m`` (range) beyond it, up to ``aside_m`` to the side) with probability
    ``ahead``, else anywhere. Each action's length is uniform in ``length_m``; its heading is the
    last one, turned a share ``pull`` of the way to the pushed object's centre, plus normal noise.
    """

    num_actions: int
    scatter: ScatterConfig
    middle_m: float
    lead_m: float
    clearance_m: tuple[float, float]
    aim: float
    ahead: float
    ahead_m: tuple[float, float]
    aside_m: float
    length_m: tuple[float, float]
    pull: float
    noise_deg: float
    topple_deg: float


class SceneRejected(Exception):
    """This attempt at a scene or an episode is no good (the reason is the message); draw
    another.
    """


@dataclass(frozen=True)
class Start:
    """A scene before the first push: bodies standing at ``world_T_obj_N44``, the tip, the first
    heading.
    """

    bodies: tuple[Body, ...]
    world_T_obj_N44: Floats
    tip_world_3: Floats
    heading_rad: float


def draw_start(
    meshes: Sequence["Mesh"],
    num_objects: int,
    bodies_cfg: BodiesConfig,
    robot: RobotConfig,
    cfg: PushesConfig,
    rng: np.random.Generator,
) -> Start:
    """A random scene (paper appendix B). Raises Rejected."""
    chosen = draw_meshes(meshes, num_objects, rng)
    bodies = [draw_body(mesh, bodies_cfg, rng) for mesh in chosen]
    heading_rad = rng.uniform(-np.pi, np.pi)
    forward = _direction(heading_rad)
    first_xy = rng.uniform(-cfg.middle_m, cfg.middle_m, 2) - cfg.lead_m * forward
    poses = [upright(chosen[0], bodies[0], first_xy, rng.uniform(-np.pi, np.pi))]
    outlines = [body_footprint(chosen[0], bodies[0], poses[0])]
    tip_xy = _tip_start(outlines[0], first_xy, forward, cfg, robot.rod_radius_m, rng)
    outlines_and_rod = [*outlines, shapely.Point(tip_xy).buffer(robot.rod_radius_m)]
    for mesh, body in zip(chosen[1:], bodies[1:], strict=True):
        pose, outline = _place_next(mesh, body, first_xy, forward, outlines_and_rod, cfg, rng)
        poses.append(pose)
        outlines_and_rod.append(outline)
    return Start(
        tuple(bodies), np.array(poses), np.array([*tip_xy, robot.tip_height_m]), float(heading_rad)
    )


def draw_meshes(
    meshes: Sequence["Mesh"], num_objects: int, rng: np.random.Generator
) -> list["Mesh"]:
    """Different meshes while there are enough of them."""
    if not meshes:
        raise ValueError("no meshes to draw from")
    return [
        meshes[i] for i in rng.choice(len(meshes), num_objects, replace=num_objects > len(meshes))
    ]


def scatter(
    meshes: Sequence["Mesh"], bodies: Sequence[Body], cfg: ScatterConfig, rng: np.random.Generator
) -> Floats:
    """Upright poses N44 of bodies standing apart, anywhere on the table. Raises Rejected where they
    do not fit.
    """
    poses: list[Floats] = []
    outlines: list[shapely.Geometry] = []
    for mesh, body in zip(meshes, bodies, strict=True):
        for _ in range(TRIES):
            pose = upright(
                mesh, body, rng.uniform(-cfg.spread_m, cfg.spread_m, 2), rng.uniform(-np.pi, np.pi)
            )
            outline = body_footprint(mesh, body, pose)
            if is_free(outline, outlines, cfg):
                poses.append(pose)
                outlines.append(outline)
                break
        else:
            raise SceneRejected("no room for an object")
    return np.array(poses).reshape(-1, 4, 4)


def is_free(
    outline: shapely.Geometry, others: Sequence[shapely.Geometry], cfg: ScatterConfig
) -> bool:
    """True where an outline lies inside the table's rim and keeps its distance from the others."""
    edge = shapely.box(-cfg.rim_m, -cfg.rim_m, cfg.rim_m, cfg.rim_m)
    return bool(edge.contains(outline)) and all(
        outline.distance(other) >= cfg.gap_m for other in others
    )


def draw_heading(
    tip_3: Floats, target_3: Floats, heading_rad: float, cfg: PushesConfig, rng: np.random.Generator
) -> float:
    """The next action's heading: the last one, turned part of the way to the target, plus noise."""
    to_target = np.arctan2(target_3[1] - tip_3[1], target_3[0] - tip_3[0])
    turn = (to_target - heading_rad + np.pi) % (2 * np.pi) - np.pi
    return float(heading_rad + cfg.pull * turn + np.radians(cfg.noise_deg) * rng.normal())


def draw_action(heading_rad: float, cfg: PushesConfig, rng: np.random.Generator) -> Floats:
    """A horizontal displacement (3) of the rod along ``heading_rad``, of random length."""
    return np.array([*(rng.uniform(*cfg.length_m) * _direction(heading_rad)), 0.0])


def _direction(angle_rad: float) -> Floats:
    return np.array([np.cos(angle_rad), np.sin(angle_rad)])


def _tip_start(
    outline: shapely.Geometry,
    center_xy: Floats,
    forward: Floats,
    cfg: PushesConfig,
    rod_radius_m: float,
    rng: np.random.Generator,
) -> Floats:
    """Where a rod coming along ``forward``, off the centre by a random aim, is a clearance away
    from the outline.
    """
    side = np.array([-forward[1], forward[0]])
    across = (shapely.get_coordinates(outline) - center_xy) @ side
    offset = rng.uniform(-cfg.aim, cfg.aim) * (across.max() - across.min()) / 2
    distances = np.arange(MARCH_FROM_M, 0.0, -MARCH_M)
    line = center_xy + offset * side - distances[:, None] * forward
    is_near = shapely.distance(shapely.points(line), outline) < rod_radius_m + rng.uniform(
        *cfg.clearance_m
    )
    if not is_near.any() or is_near[0]:
        raise SceneRejected("the rod's line misses the object")
    return np.asarray(line[int(np.argmax(is_near)) - 1])


def _place_next(
    mesh: "Mesh",
    body: Body,
    first_xy: Floats,
    forward: Floats,
    others: Sequence[shapely.Geometry],
    cfg: PushesConfig,
    rng: np.random.Generator,
) -> tuple[Floats, shapely.Geometry]:
    """Pose and outline of one more object: in the way of the pushed one, or anywhere free. Raises
    Rejected.
    """
    side = np.array([-forward[1], forward[0]])
    is_ahead = rng.random() < cfg.ahead
    for _ in range(TRIES):
        yaw_rad = rng.uniform(-np.pi, np.pi)
        pose = upright(
            mesh, body, rng.uniform(-cfg.scatter.spread_m, cfg.scatter.spread_m, 2), yaw_rad
        )
        if is_ahead:
            reach = (
                _extent(others[0], first_xy, forward)
                + aabb(mesh.visual.vertices * body.scale_3)[1][:2].mean() / 2
            )
            beyond = first_xy + (reach + rng.uniform(*cfg.ahead_m)) * forward
            pose = upright(
                mesh, body, beyond + rng.uniform(-cfg.aside_m, cfg.aside_m) * side, yaw_rad
            )
        outline = body_footprint(mesh, body, pose)
        if is_free(outline, others, cfg.scatter):
            return pose, outline
    raise SceneRejected("no room for an object")


def _extent(outline: shapely.Geometry, center_xy: Floats, forward: Floats) -> float:
    """How far an outline reaches from a point along a direction."""
    return float(((shapely.get_coordinates(outline) - center_xy) @ forward).max())
