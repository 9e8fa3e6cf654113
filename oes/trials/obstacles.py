"""Obstacles between an object and its goal, so placed that no straight way is free and yet there is
a way (C.3).
"""

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
    """Objects in the way. The first stands at a share of ``along`` (range) of the straight way, up
    to ``aside_m`` off it, the others anywhere; all keep ``gap_m`` from each other and from the
    object at its start and at its goal, and leave a way on which it could pass so far from all,
    however it is turned.
    """

    count: int
    along: tuple[float, float]
    aside_m: float
    gap_m: float


def draw_obstacles(
    outline: shapely.Geometry,
    way_22: Floats,
    things: Sequence[tuple[Mesh, Body]],
    table: ScatterConfig,
    cfg: ObstaclesConfig,
    rng: np.random.Generator,
) -> Floats:
    """Poses of the obstacles ``things``: O44. ``outline`` is the object's at the start of
    ``way_22``, which ends at its goal. Raises Rejected.
    """
    start, goal = shapely.points(way_22)
    inner_m, outer_m = outline.boundary.distance(start), shapely.hausdorff_distance(outline, start)
    straight = shapely.LineString(way_22).buffer(inner_m)
    taken = [start.buffer(outer_m), goal.buffer(outer_m)]
    poses: list[Floats] = []
    for mesh, body in things:
        xy = (
            rng.uniform(-table.spread_m, table.spread_m, 2)
            if poses
            else _in_the_way(way_22, cfg, rng)
        )
        poses.append(upright(mesh, body, xy, rng.uniform(-np.pi, np.pi)))
        taken.append(body_footprint(mesh, body, poses[-1]))
        if min(taken[-1].distance(other) for other in taken[:-1]) < cfg.gap_m:
            raise SceneRejected("an obstacle stands too close to something")
    if not taken[2].intersects(straight):
        raise SceneRejected("a straight way is free")
    edge = shapely.box(-table.rim_m, -table.rim_m, table.rim_m, table.rim_m)
    room = edge.buffer(-outer_m).difference(
        shapely.union_all(taken[2:]).buffer(outer_m + cfg.gap_m)
    )
    if not any(part.contains(start) and part.contains(goal) for part in shapely.get_parts(room)):
        raise SceneRejected("no way is free")
    return np.array(poses)


def _in_the_way(way_22: Floats, cfg: ObstaclesConfig, rng: np.random.Generator) -> Floats:
    along = way_22[1] - way_22[0]
    aside = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    return np.asarray(
        way_22[0] + rng.uniform(*cfg.along) * along + rng.uniform(-cfg.aside_m, cfg.aside_m) * aside
    )
