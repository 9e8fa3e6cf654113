"""Random falling scenes: upright blocks, and one more in the air above or beside them."""

from collections.abc import Sequence

import numpy as np
import shapely
from scipy.spatial.transform import Rotation

from oes.config import params
from oes.episode import Body, Floats
from oes.geom.boxes import aabb
from oes.geom.se3 import rigid, transform
from oes.meshes.catalogue import Mesh
from oes.sim.bodies import body_footprint
from oes.sim.scene import ScatterConfig, SceneRejected


@params
class FallsConfig:
    """Random drops of the last block, recorded for ``num_steps`` of ``timestep_ms``.

    ``scatter``: placement of the other blocks.
    ``above_prob``: probability that the block starts above another one; else it starts anywhere in
    +- ``scatter.spread_m``.
    ``lateral_m``: largest horizontal distance from the centre of the block below.
    ``gap_m``: range of the free height below the block at its start.
    ``ceiling_m``: largest height of its top.
    """

    num_steps: int
    timestep_ms: int
    scatter: ScatterConfig
    above_prob: float
    lateral_m: float
    gap_m: tuple[float, float]
    ceiling_m: float


def draw_drop(
    meshes: Sequence[Mesh],
    bodies: Sequence[Body],
    standing_N44: Floats,
    cfg: FallsConfig,
    rng: np.random.Generator,
) -> Floats:
    """Initial ``world_T_obj`` of the last body, in any orientation, above ``standing_N44``.

    Raises SceneRejected if it would start above ``ceiling_m``.
    """
    obstacles = [
        (
            body_footprint(mesh, body, pose),
            float(transform(pose, mesh.visual.vertices * body.scale_3)[:, 2].max()),
        )
        for mesh, body, pose in zip(meshes, bodies, standing_N44, strict=False)
    ]
    xy = _drop_position([footprint for footprint, _ in obstacles], cfg, rng)
    rotation_33 = Rotation.random(random_state=rng).as_matrix()
    points_P3 = meshes[-1].visual.vertices * bodies[-1].scale_3 @ rotation_33.T
    center_3, size_3 = aabb(points_P3)
    pose = rigid(rotation_33, np.array([*(xy - center_3[:2]), 0.0]))
    footprint = body_footprint(meshes[-1], bodies[-1], pose)
    tops = [top for other, top in obstacles if other.intersects(footprint)]
    bottom_m = max(tops, default=0.0) + rng.uniform(*cfg.gap_m)
    if bottom_m + size_3[2] > cfg.ceiling_m:
        raise SceneRejected("the falling object would start too high")
    pose[2, 3] = bottom_m - points_P3[:, 2].min()
    return pose


def _drop_position(
    footprints: Sequence[shapely.Geometry], cfg: FallsConfig, rng: np.random.Generator
) -> Floats:
    """Horizontal position (2) of the falling object's box centre."""
    if not footprints or rng.random() > cfg.above_prob:
        return np.asarray(rng.uniform(-cfg.scatter.spread_m, cfg.scatter.spread_m, 2))
    below = footprints[int(rng.integers(len(footprints)))]
    # The square root makes the offset uniform over the disc.
    angle, distance = rng.uniform(0, 2 * np.pi), cfg.lateral_m * np.sqrt(rng.random())
    offset_2 = distance * np.array([np.cos(angle), np.sin(angle)])
    return np.asarray(below.centroid.coords[0] + offset_2)
