"""Control tasks: initial poses of novel objects, obstacles and goals (paper appendix C.3)."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from oes.config import params
from oes.episode import Body, Floats
from oes.meshes.catalogue import Catalogue, Mesh
from oes.mpc.sampler import PlannerConfig
from oes.sim.bodies import body_footprint, draw_body, true_box, upright
from oes.sim.scene import ScatterConfig, SceneRejected, draw_meshes, scatter
from oes.sim.world import SimConfig


@params
class ObstaclesConfig:
    """Obstacles on the table, the first of which blocks the straight path to the goal.

    It stands at ``path_fraction`` (range) of the path, offset by up to ``lateral_m``. All obstacles
    keep ``gap_m`` from each other, the object and its goal, and leave a path with that clearance at
    any orientation of the object.
    """

    count: int
    path_fraction: tuple[float, float]
    lateral_m: float
    gap_m: float


@params
class TrialScenario:
    """Distribution of tasks, and the planners tried on each.

    ``goal_distance_m``: range of the distance of a goal from its object's start.
    ``goal_spread_m``: largest |x| and |y| of a goal.
    ``goal_gap_m``: smallest gap between the enclosing circles of objects at their goals.
    ``stop_m``: a trial ends when every object's estimated distance is below, or after
    ``max_steps`` pushes. ``success_m``: a trial succeeds when the true mean distance is below.
    ``settle_ms``: time after each push. ``max_attempts``: samples until a task is feasible.
    """

    num_objects: tuple[int, int]
    scatter: ScatterConfig
    goal_distance_m: tuple[float, float]
    goal_spread_m: float
    goal_gap_m: float
    obstacles: ObstaclesConfig
    max_steps: int
    success_m: float
    stop_m: float
    settle_ms: int
    max_attempts: int
    planners: dict[str, PlannerConfig]


@dataclass(frozen=True)
class Task:
    """Initial state of a trial, and goals of the first G box centres (world, metres).

    The other objects are obstacles. ``tip_xy_m``: initial position of the rod.
    """

    bodies: tuple[Body, ...]
    world_T_obj_N44: Floats
    center_N3: Floats
    goal_G3: Floats
    tip_xy_m: Floats


def generator(seed: int, scenario: str, trial_i: int, stream: int) -> np.random.Generator:
    """Random numbers for one purpose (stream) in one trial, the same for every model."""
    return np.random.default_rng([seed, zlib.crc32(scenario.encode()), trial_i, stream])


def draw_task(
    catalogue: Catalogue, sim: SimConfig, cfg: TrialScenario, rng: np.random.Generator
) -> Task:
    """A random task with test objects. Raises SceneRejected when no attempt is feasible."""
    reason = ""
    for _ in range(cfg.max_attempts):
        try:
            return _attempt(catalogue, sim, cfg, rng)
        except SceneRejected as error:
            reason = str(error)
    raise SceneRejected(f"no task in {cfg.max_attempts} attempts; the last failed with: {reason}")


def _attempt(
    catalogue: Catalogue, sim: SimConfig, cfg: TrialScenario, rng: np.random.Generator
) -> Task:
    low, high = cfg.num_objects
    num_moved = int(rng.integers(low, high + 1))
    meshes = draw_meshes(catalogue.split("test"), num_moved + cfg.obstacles.count, rng)
    bodies = tuple(draw_body(mesh, sim.bodies, rng) for mesh in meshes)
    objects = list(zip(meshes, bodies, strict=True))
    poses = scatter(meshes[:num_moved], bodies[:num_moved], cfg.scatter, rng)
    center_G3, size_G3 = _boxes(objects[:num_moved], poses)
    goal_G3 = _goals(center_G3, np.linalg.norm(size_G3[:, :2], axis=1) / 2, cfg, rng)
    if cfg.obstacles.count:
        path_22 = np.stack([center_G3[0, :2], goal_G3[0, :2]])
        footprint, others = body_footprint(*objects[0], poses[0]), objects[num_moved:]
        obstacles = _obstacles(footprint, path_22, others, cfg.scatter, cfg.obstacles, rng)
        poses = np.concatenate([poses, obstacles])
    center_N3, size_N3 = _boxes(objects, poses)
    return Task(bodies, poses, center_N3, goal_G3, _free_tip(center_N3, size_N3, sim, rng))


def _boxes(objects: Sequence[tuple[Mesh, Body]], poses: Floats) -> tuple[Floats, Floats]:
    """Box centres N3 and sizes N3 of posed bodies."""
    boxes = [true_box(*pair, pose) for pair, pose in zip(objects, poses, strict=True)]
    centers, sizes = zip(*boxes, strict=True)
    return np.array(centers), np.array(sizes)


def _goals(
    center_N3: Floats, radius_N: Floats, cfg: TrialScenario, rng: np.random.Generator
) -> Floats:
    """A goal per object at a uniform distance and bearing. Raises SceneRejected."""
    distance = rng.uniform(*cfg.goal_distance_m, size=len(center_N3))
    bearing = rng.uniform(-np.pi, np.pi, size=len(center_N3))
    direction_N3 = np.stack([np.cos(bearing), np.sin(bearing), 0 * bearing], axis=1)
    goals = center_N3 + distance[:, None] * direction_N3
    if np.abs(goals[:, :2]).max() > cfg.goal_spread_m:
        raise SceneRejected("a goal lies outside its bounds")
    for i, j in zip(*np.triu_indices(len(goals), 1), strict=True):
        if np.linalg.norm(goals[i] - goals[j]) < radius_N[i] + radius_N[j] + cfg.goal_gap_m:
            raise SceneRejected("two goals are too close to each other")
    return np.asarray(goals)


def _free_tip(
    center_N3: Floats, size_N3: Floats, sim: SimConfig, rng: np.random.Generator
) -> Floats:
    """A position of the rod, one diameter off every object's box. Raises SceneRejected."""
    tip_xy = rng.uniform(-sim.robot.workspace_m, sim.robot.workspace_m, size=2)
    outside = np.abs(tip_xy - center_N3[:, :2]) > size_N3[:, :2] / 2 + 2 * sim.robot.rod_radius_m
    if not outside.any(axis=1).all():
        raise SceneRejected("the rod would stand on an object")
    return np.asarray(tip_xy)


def _obstacles(
    footprint: shapely.Geometry,
    path_22: Floats,
    obstacles: Sequence[tuple[Mesh, Body]],
    table: ScatterConfig,
    cfg: ObstaclesConfig,
    rng: np.random.Generator,
) -> Floats:
    """Poses (n, 4, 4) of the obstacles; ``path_22`` is the object's start and goal.

    ``footprint`` is the object's at the start. Raises SceneRejected.
    """
    start, goal = shapely.points(path_22)
    inner_m = footprint.boundary.distance(start)
    outer_m = shapely.hausdorff_distance(footprint, start)
    taken = [start.buffer(outer_m), goal.buffer(outer_m)]
    poses: list[Floats] = []
    for mesh, body in obstacles:
        xy = rng.uniform(-table.spread_m, table.spread_m, 2) if poses else _near(path_22, cfg, rng)
        poses.append(upright(mesh, body, xy, rng.uniform(-np.pi, np.pi)))
        taken.append(body_footprint(mesh, body, poses[-1]))
        if min(taken[-1].distance(other) for other in taken[:-1]) < cfg.gap_m:
            raise SceneRejected("an obstacle stands too close to something")
    # The inscribed disc: a path that is blocked for it is blocked at every orientation.
    if not taken[2].intersects(shapely.LineString(path_22).buffer(inner_m)):
        raise SceneRejected("the straight path is free")
    # Positions of the circumscribed disc; start and goal must lie in the same connected part.
    edge_m = table.table_edge_m
    table_box = shapely.box(-edge_m, -edge_m, edge_m, edge_m)
    blocked = shapely.union_all(taken[2:]).buffer(outer_m + cfg.gap_m)
    free = shapely.get_parts(table_box.buffer(-outer_m).difference(blocked))
    if not any(part.contains(start) and part.contains(goal) for part in free):
        raise SceneRejected("no path is free")
    return np.array(poses)


def _near(path_22: Floats, cfg: ObstaclesConfig, rng: np.random.Generator) -> Floats:
    along = path_22[1] - path_22[0]
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    fraction = rng.uniform(*cfg.path_fraction)
    lateral_m = rng.uniform(-cfg.lateral_m, cfg.lateral_m)
    return np.asarray(path_22[0] + fraction * along + lateral_m * normal)
