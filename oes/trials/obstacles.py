"""Obstacles between an object and its goal that block the straight path but leave another (C.3)."""

from collections.abc import Sequence

import numpy as np
import shapely

from oes.config import params
from oes.episode import Body, Floats
from oes.meshes.catalogue import Mesh
from oes.sim.bodies import body_footprint, upright
from oes.sim.scene import ScatterConfig, SceneRejected


@params
class ObstaclesConfig:
    """The first obstacle stands at a fraction (range) of the straight path, up to ``lateral_m``
    beside it; the others stand anywhere. All keep ``gap_m`` from each other, from the object and
    from its goal, and leave a path with that clearance at any orientation of the object.
    """

    count: int
    path_fraction: tuple[float, float]
    lateral_m: float
    gap_m: float


def draw_obstacles(
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
        xy = _uniform_xy(table, rng) if poses else _near_path(path_22, cfg, rng)
        poses.append(upright(mesh, body, xy, rng.uniform(-np.pi, np.pi)))
        taken.append(body_footprint(mesh, body, poses[-1]))
        if min(taken[-1].distance(other) for other in taken[:-1]) < cfg.gap_m:
            raise SceneRejected("an obstacle stands too close to something")
    # The inscribed disc: a path that is blocked for it is blocked at every orientation.
    if not taken[2].intersects(shapely.LineString(path_22).buffer(inner_m)):
        raise SceneRejected("the straight path is free")
    # Positions of the circumscribed disc; start and goal must lie in the same connected part.
    table_edge = shapely.box(-table.rim_m, -table.rim_m, table.rim_m, table.rim_m)
    blocked = shapely.union_all(taken[2:]).buffer(outer_m + cfg.gap_m)
    free = shapely.get_parts(table_edge.buffer(-outer_m).difference(blocked))
    if not any(part.contains(start) and part.contains(goal) for part in free):
        raise SceneRejected("no path is free")
    return np.array(poses)


def _uniform_xy(table: ScatterConfig, rng: np.random.Generator) -> Floats:
    return rng.uniform(-table.spread_m, table.spread_m, 2)


def _near_path(path_22: Floats, cfg: ObstaclesConfig, rng: np.random.Generator) -> Floats:
    along = path_22[1] - path_22[0]
    normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    fraction, lateral_m = (
        rng.uniform(*cfg.path_fraction),
        rng.uniform(-cfg.lateral_m, cfg.lateral_m),
    )
    return np.asarray(path_22[0] + fraction * along + lateral_m * normal)
