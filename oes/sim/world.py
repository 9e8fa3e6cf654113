"""The world: one Bullet client with the table, the arm and bodies; only here does time pass."""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from oes.config import params
from oes.episode import FIRST_OBJECT, Body, Camera, Floats, Step
from oes.meshes.catalogue import Catalogue
from oes.sim.arm import ArmConfig, RodArm
from oes.sim.bodies import BodiesConfig, get_pose, mass_frame, set_pose, spawn, true_box
from oes.sim.client import Bullet
from oes.sim.rig import RigConfig
from oes.sim.robot import RobotConfig, write_urdf

GRAVITY_M_S2 = 9.81
NS_PER_MS = 1_000_000


@params
class PhysicsConfig:
    """Clock, solver, table; ``timestep_ms`` is one action, a multiple of ``step_ms``."""

    step_ms: int
    timestep_ms: int
    solver_iterations: int
    table_size_m: tuple[float, float, float]
    table_friction: float
    rod_friction: float


@params
class SimConfig:
    """The simulated world, independent of the task."""

    physics: PhysicsConfig
    robot: RobotConfig
    arm: ArmConfig
    bodies: BodiesConfig
    rig: RigConfig


def count_steps(duration_ms: int, cfg: PhysicsConfig) -> int:
    """Number of physics steps in ``duration_ms``. Raises ValueError unless whole and positive."""
    if cfg.step_ms < 1 or duration_ms < 1 or duration_ms % cfg.step_ms:
        raise ValueError(f"{duration_ms} ms is no whole multiple of physics.step_ms {cfg.step_ms}")
    return duration_ms // cfg.step_ms


class World:
    """A context manager that owns one Bullet client; ``reset`` starts each scene from nothing."""

    def __init__(self, catalogue: Catalogue, cfg: SimConfig) -> None:
        """Raises ValueError if ``timestep_ms`` is no whole multiple of ``step_ms``."""
        self.catalogue, self.cfg = catalogue, cfg
        self.steps_per_action = count_steps(cfg.physics.timestep_ms, cfg.physics)
        self._folder = tempfile.TemporaryDirectory(prefix="oes-sim-")
        self._urdf = write_urdf(cfg.robot, Path(self._folder.name))
        self._bullet = Bullet()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._bullet.disconnect()
        self._folder.cleanup()

    def reset(
        self, bodies: Sequence[Body], world_T_obj_N44: Floats, tip_world_3: Floats | None
    ) -> None:
        """Set up a new scene at rest; without an arm if ``tip_world_3`` is None.

        Raises ReachError for a tip out of reach, KeyError for a mesh that the catalogue lacks.
        """
        self.bodies = tuple(bodies)
        self._empty()
        self._ids = [self._table()]
        self._arm = None if tip_world_3 is None else self._load_arm(tip_world_3)
        self._ids.append(-1 if self._arm is None else self._arm.body)
        self._obj_T_com = []
        for body, world_T_obj in zip(bodies, world_T_obj_N44, strict=True):
            mesh = self.catalogue.meshes[body.mesh]
            self._ids.append(spawn(self._bullet, mesh, body, self.cfg.bodies))
            self._obj_T_com.append(mass_frame(mesh, body.scale_3, body.mass_kg)[0])
            set_pose(self._bullet, self._ids[-1], world_T_obj, self._obj_T_com[-1])
        self._placed = np.array(world_T_obj_N44, dtype=float).reshape(-1, 4, 4), tip_world_3
        self._is_fresh = True
        self._index_of = {body_id: body_i for body_i, body_id in enumerate(self._ids)}
        self.clear_contacts()

    @property
    def arm(self) -> RodArm:
        """The arm; the world must have been reset with one."""
        assert self._arm is not None, "this world has no arm"
        return self._arm

    def run(self, duration_ms: int) -> None:
        """Advance time; the arm, if any, holds its position."""
        for _ in range(count_steps(duration_ms, self.cfg.physics)):
            self._advance()

    def push(self, action_3: Floats) -> Floats:
        """Move the tip by ``action_3`` in a straight line over one timestep, then hold it.

        Returns the squared tracking error (m2) of the tip after every physics step. Raises
        ReachError before anything moves.
        """
        joints, tips = self.arm.plan(action_3, self.steps_per_action)
        speeds = np.diff(joints, axis=0) / (self.cfg.physics.step_ms / 1000)
        errors = []
        for now, speed, target in zip(joints[:-1], speeds, tips[1:], strict=True):
            self.arm.drive(now, speed)
            self._advance()
            errors.append(((self.arm.tip() - target) ** 2).sum())
        self.arm.drive(joints[-1], np.zeros_like(joints[-1]))
        self.arm.goal_world_3 = tips[-1]
        return np.array(errors)

    def poses(self) -> Floats:
        """Current ``world_T_obj_N44``; until time passes, exactly the poses given to ``reset``."""
        if self._is_fresh:
            # Contact amplifies the last bit of a start: without it no episode could be replayed.
            return self._placed[0]
        poses = [
            get_pose(self._bullet, body_id, obj_T_com)
            for body_id, obj_T_com in zip(self._ids[FIRST_OBJECT:], self._obj_T_com, strict=True)
        ]
        return np.array(poses).reshape(-1, 4, 4)

    def clear_contacts(self) -> None:
        """Forget all contacts."""
        self._contact_AA = np.zeros((len(self._ids), len(self._ids)), dtype=bool)

    def step(self, t_ns: int, cameras: tuple[Camera, ...]) -> Step:
        """The current state, with all contacts since the last ``clear_contacts``."""
        poses, meshes = self.poses(), self.catalogue.meshes
        pairs = zip(self.bodies, poses, strict=True)
        boxes = [true_box(meshes[body.mesh], body, pose) for body, pose in pairs]
        return Step(
            t_ns=t_ns,
            world_T_obj_N44=poses,
            center_N3=np.array([center for center, _ in boxes]).reshape(-1, 3),
            size_N3=np.array([size for _, size in boxes]).reshape(-1, 3),
            tip_world_3=self._tip(),
            joints_rad_J=np.zeros(0) if self._arm is None else self._arm.joints(),
            world_T_link_L44=np.zeros((0, 4, 4)) if self._arm is None else self._arm.world_T_link(),
            contact_AA=self.contacts(),
            cameras=cameras,
        )

    def contacts(self) -> NDArray[np.bool_]:
        """Contact matrix AA of table, robot and objects since the last ``clear_contacts``."""
        return self._contact_AA.copy()

    def _tip(self) -> Floats:
        if self._arm is None:
            return np.full(3, np.nan)
        start = self._placed[1] if self._is_fresh else None
        return self._arm.tip() if start is None else start

    def _advance(self) -> None:
        self._is_fresh = False
        self._bullet.stepSimulation()
        for contact in self._bullet.getContactPoints():
            if contact[9] > 0.0:  # normal force: Bullet also lists pairs within its margin
                a, b = self._index_of[contact[1]], self._index_of[contact[2]]
                self._contact_AA[a, b] = self._contact_AA[b, a] = True

    def _empty(self) -> None:
        self._bullet.resetSimulation()
        self._bullet.setGravity(0, 0, -GRAVITY_M_S2)
        # Determinism: a fixed order of pairs, and no meshes cached from an earlier scene.
        self._bullet.setPhysicsEngineParameter(
            fixedTimeStep=self.cfg.physics.step_ms / 1000,
            numSolverIterations=self.cfg.physics.solver_iterations,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
        )

    def _table(self) -> int:
        bullet, physics = self._bullet, self.cfg.physics
        half = np.array(physics.table_size_m) / 2
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=half.tolist())
        table = bullet.createMultiBody(0, shape, basePosition=[0, 0, -half[2]])
        friction = physics.table_friction
        bullet.changeDynamics(table, -1, lateralFriction=friction, restitution=0.0)
        return int(table)

    def _load_arm(self, tip_world_3: Floats) -> RodArm:
        bullet, robot, friction = self._bullet, self.cfg.robot, self.cfg.physics.rod_friction
        body = bullet.loadURDF(str(self._urdf), basePosition=robot.base_m, useFixedBase=True)
        for link_i in range(-1, bullet.getNumJoints(body)):
            bullet.changeDynamics(body, link_i, lateralFriction=friction, restitution=0.0)
        arm = RodArm(bullet, body, self.cfg.arm, robot)
        arm.reset_to(tip_world_3)
        return arm
