"""Random falling scenes: blocks standing close together, and one more in the air above them or
beside them.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import shapely
from scipy.spatial.transform import Rotation

from oes.config import params
from oes.episode import Body, Floats
from oes.geom.boxes import aabb
from oes.geom.se3 import rigid, transform
from oes.sim.bodies import body_footprint
from oes.sim.scene import ScatterConfig, SceneRejected

if TYPE_CHECKING:
    from oes.meshes.catalogue import Mesh


@params
class FallsConfig:
    """How a block is dropped, and how long it is watched: ``num_steps`` of ``timestep_ms`` each.

    The others stand as ``scatter`` says. The falling one is turned anyhow; its centre is above a
    standing one's, off by up to ``aside_m``, with probability ``over``, else above any place in +-
    ``spread_m`` of the table's centre. Its lowest point starts ``gap_m`` (range) above whatever
    stands beneath its outline, its highest below ``ceiling_m``.
    """

    num_steps: int
    timestep_ms: int
    scatter: ScatterConfig
    over: float
    aside_m: float
    gap_m: tuple[float, float]
    ceiling_m: float


def draw_drop(
    meshes: Sequence["Mesh"],
    bodies: Sequence[Body],
    standing_N44: Floats,
    cfg: FallsConfig,
    rng: np.random.Generator,
) -> Floats:
    """``world_T_obj`` of the last body before it falls; the others stand at ``standing_N44``.
    Raises Rejected.
    """
    place = _place(meshes, bodies, standing_N44, cfg, rng)
    turn_33 = Rotation.random(random_state=rng).as_matrix()
    points_P3 = meshes[-1].visual.vertices * bodies[-1].scale_3 @ turn_33.T
    center_3, size_3 = aabb(points_P3)
    pose = rigid(turn_33, np.array([*(place - center_3[:2]), 0.0]))
    outline = body_footprint(meshes[-1], bodies[-1], pose)
    beneath_m = max((top_m for shadow, top_m in _standing(meshes, bodies, standing_N44) if shadow.intersects(outline)),
                    default=0.0)  # fmt: skip
    lowest_m = beneath_m + rng.uniform(*cfg.gap_m)
    if lowest_m + size_3[2] > cfg.ceiling_m:
        raise SceneRejected("the falling object would start too high")
    pose[2, 3] = lowest_m - points_P3[:, 2].min()
    return pose


def _place(
    meshes: Sequence["Mesh"],
    bodies: Sequence[Body],
    standing_N44: Floats,
    cfg: FallsConfig,
    rng: np.random.Generator,
) -> Floats:
    """Where the falling object's centre lies, seen from above."""
    if len(standing_N44) == 0 or rng.random() > cfg.over:
        return np.asarray(rng.uniform(-cfg.scatter.spread_m, cfg.scatter.spread_m, 2))
    below_i = int(rng.integers(len(standing_N44)))
    shadow = body_footprint(meshes[below_i], bodies[below_i], standing_N44[below_i])
    angle, distance = rng.uniform(0, 2 * np.pi), cfg.aside_m * np.sqrt(rng.random())
    offset_2 = distance * np.array([np.cos(angle), np.sin(angle)])
    return np.asarray(shadow.centroid.coords[0] + offset_2)


def _standing(
    meshes: Sequence["Mesh"], bodies: Sequence[Body], standing_N44: Floats
) -> list[tuple[shapely.Geometry, float]]:
    """Outline from above and height of the top of every standing object."""
    return [
        (
            body_footprint(mesh, body, pose),
            float(transform(pose, mesh.visual.vertices * body.scale_3)[:, 2].max()),
        )
        for mesh, body, pose in zip(meshes, bodies, standing_N44, strict=False)
    ]
