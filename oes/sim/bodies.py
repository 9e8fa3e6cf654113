"""Catalogue meshes as Bullet bodies: inertial frame, footprint, bounding box and pose."""

import numpy as np
import shapely

from oes.config import params
from oes.episode import Body, Floats
from oes.geom.boxes import aabb
from oes.geom.se3 import from_quat_xyzw, inverse, quat_xyzw, rigid, rotation_z, transform
from oes.meshes.catalogue import Mesh
from oes.sim.client import Bullet


@params
class BodiesConfig:
    """Distribution of the bodies' properties.

    ``mass_kg``, ``friction``: nominal values; friction is that against the table, whose own is 1
    (Bullet multiplies the coefficients of two bodies).
    ``randomize``: range of the log-uniform factor on both.
    ``scale``: range of the uniform scale per axis, by the split of the mesh. It is wider for
    training meshes, as generalisation to new shapes comes from variety.
    ``spinning_friction_m``, ``rolling_friction_m``: Bullet's torsional coefficients.
    """

    mass_kg: float
    friction: float
    randomize: tuple[float, float]
    scale: dict[str, tuple[float, float]]
    spinning_friction_m: float
    rolling_friction_m: float

    def __post_init__(self) -> None:
        """Raises ValueError (a ParamsError when read from a file) if ``scale`` lacks a split."""
        if set(self.scale) != {"train", "test"}:
            raise ValueError(f"scale: expected exactly train, test; found {', '.join(self.scale)}")


def draw_body(mesh: Mesh, cfg: BodiesConfig, rng: np.random.Generator) -> Body:
    """A body of random size, mass, friction and texture (paper appendix B: textures)."""
    low, high = np.log(cfg.randomize)
    mass, friction = np.array([cfg.mass_kg, cfg.friction]) * np.exp(rng.uniform(low, high, 2))
    return Body(
        mesh=mesh.id,
        category=mesh.category,
        scale_3=rng.uniform(*cfg.scale[mesh.split], 3),
        mass_kg=float(mass),
        friction=float(friction),
        texture_seed=int(rng.integers(2**31)),
    )


def mass_frame(mesh: Mesh, scale_3: Floats, mass_kg: float) -> tuple[Floats, Floats]:
    """Inertial frame ``obj_T_com`` (along the principal axes) and principal moments (3, kg m2)."""
    # Second moments, unlike the inertia tensor, scale axis by axis, so the result is exact.
    second_33 = 0.5 * np.trace(mesh.inertia_obj_33) * np.eye(3) - mesh.inertia_obj_33
    second_33 = second_33 * np.outer(scale_3, scale_3) * mass_kg / mesh.volume_m3
    moments, axes = np.linalg.eigh(np.trace(second_33) * np.eye(3) - second_33)
    axes[:, 2] *= np.sign(np.linalg.det(axes))  # eigenvectors may form a left-handed frame
    return rigid(axes, mesh.com_obj_3 * scale_3), moments


def spawn(bullet: Bullet, mesh: Mesh, body: Body, cfg: BodiesConfig) -> int:
    """Add a dynamic compound of the mesh's convex parts; returns its id. Its pose is not set."""
    obj_T_com, moments = mass_frame(mesh, body.scale_3, body.mass_kg)
    shape = bullet.createCollisionShape(
        bullet.GEOM_MESH, fileName=str(mesh.collision_path), meshScale=body.scale_3.tolist()
    )
    body_id = bullet.createMultiBody(
        baseMass=body.mass_kg,
        baseCollisionShapeIndex=shape,
        baseInertialFramePosition=obj_T_com[:3, 3].tolist(),
        baseInertialFrameOrientation=quat_xyzw(obj_T_com[:3, :3]).tolist(),
    )
    # Bullet's own moments are those of the bounding box; its damping would act as air drag.
    bullet.changeDynamics(
        body_id,
        -1,
        localInertiaDiagonal=moments.tolist(),
        lateralFriction=body.friction,
        spinningFriction=cfg.spinning_friction_m,
        rollingFriction=cfg.rolling_friction_m,
        restitution=0.0,
        linearDamping=0.0,
        angularDamping=0.0,
    )
    return int(body_id)


def set_pose(bullet: Bullet, body_id: int, world_T_obj: Floats, obj_T_com: Floats) -> None:
    """Put a body at rest at ``world_T_obj``; Bullet's own pose is that of the inertial frame."""
    world_T_com = world_T_obj @ obj_T_com
    bullet.resetBasePositionAndOrientation(
        body_id, world_T_com[:3, 3].tolist(), quat_xyzw(world_T_com[:3, :3]).tolist()
    )
    bullet.resetBaseVelocity(body_id, [0, 0, 0], [0, 0, 0])


def get_pose(bullet: Bullet, body_id: int, obj_T_com: Floats) -> Floats:
    """``world_T_obj`` (4x4) of a body."""
    position, quat = bullet.getBasePositionAndOrientation(body_id)
    world_T_com = rigid(from_quat_xyzw(np.array(quat)), np.array(position))
    return world_T_com @ inverse(obj_T_com)


def upright(mesh: Mesh, body: Body, xy_m: Floats, yaw_rad: float) -> Floats:
    """``world_T_obj`` of a body that stands on the table with its box centre above ``xy_m``."""
    height = -mesh.visual.bounds[0, 2] * body.scale_3[2]
    return rigid(rotation_z(yaw_rad), np.array([*xy_m, height]))


def true_box(mesh: Mesh, body: Body, world_T_obj: Floats) -> tuple[Floats, Floats]:
    """Centre and size of the axis-aligned box (world axes) around the posed mesh."""
    return aabb(transform(world_T_obj, mesh.visual.vertices * body.scale_3))


def body_footprint(mesh: Mesh, body: Body, world_T_obj: Floats) -> shapely.Geometry:
    """Vertical projection of the posed body: the union of those of its convex parts."""
    points = [transform(world_T_obj, part.vertices * body.scale_3)[:, :2] for part in mesh.parts]
    return shapely.union_all([shapely.MultiPoint(part_P2).convex_hull for part_P2 in points])
