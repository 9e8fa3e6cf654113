"""The world: one Bullet client with a table, the arm and some bodies; the only place where time
passes.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from oes.config import params
from oes.episode import Body, Camera, Floats, Step
from oes.sim.arm import ArmConfig, RodArm
from oes.sim.bodies import BodiesConfig, get_pose, mass_frame, set_pose, spawn, true_box
from oes.sim.client import Bullet
from oes.sim.rig import RigConfig
from oes.sim.robot import RobotConfig, write_urdf

if TYPE_CHECKING:
    from oes.meshes.catalogue import Catalogue

GRAVITY_M_S2 = 9.81
NS_PER_MS = 1_000_000
TABLE, ROBOT, FIRST_OBJECT = 0, 1, 2  # the order of Step.contact_AA


@params
class PhysicsConfig:
    """The clock and the table. ``timestep_ms`` is one action's; it must be a whole number of
    physics steps.
    """

    step_ms: int
    timestep_ms: int
    solver_iterations: int
    table_size_m: tuple[float, float, float]
    table_friction: float
    rod_friction: float


@params
class SimConfig:
    """Everything about the simulated world that does not depend on what happens in it."""

    physics: PhysicsConfig
    robot: RobotConfig
    arm: ArmConfig
    bodies: BodiesConfig
    rig: RigConfig


def count_steps(duration_ms: int, cfg: PhysicsConfig) -> int:
    """Physics steps in ``duration_ms``. Raises ValueError unless it is a whole, positive number of
    them.
    """
    if cfg.step_ms < 1 or duration_ms < 1 or duration_ms % cfg.step_ms:
        raise ValueError(
            f"{duration_ms} ms is no whole multiple of physics.step_ms = {cfg.step_ms}"
        )
    return duration_ms // cfg.step_ms


class World:
    """A context manager that owns one Bullet client (no window); ``reset`` starts each scene from
    nothing.
    """

    def __init__(self, catalogue: "Catalogue", cfg: SimConfig) -> None:
        """Raises ValueError when an action's timestep is no whole multiple of the physics step."""
        self.catalogue, self.cfg = catalogue, cfg
        self.steps_per_action = count_steps(cfg.physics.timestep_ms, cfg.physics)
        self._folder = tempfile.TemporaryDirectory(prefix="oes-sim-")
        self._urdf = write_urdf(cfg.robot, Path(self._folder.name))
        self._bullet = Bullet()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bullet.disconnect()
        self._folder.cleanup()

    def reset(
        self, bodies: Sequence[Body], world_T_obj_N44: Floats, tip_world_3: Floats | None
    ) -> None:
        """Empty the world and set it up afresh, all at rest; no arm when ``tip_world_3`` is None.

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
        self._thing_of = {body_id: thing_i for thing_i, body_id in enumerate(self._ids)}
        self.clear_contacts()

    @property
    def arm(self) -> RodArm:
        """The arm of a world that was reset with one."""
        assert self._arm is not None, "this world has no arm"
        return self._arm

    def run(self, duration_ms: int) -> None:
        """Let time pass; the arm, if there is one, holds still."""
        for _ in range(count_steps(duration_ms, self.cfg.physics)):
            self._advance()

    def push(self, action_3: Floats) -> Floats:
        """Move the tip by ``action_3``, in a straight line from where it was last commanded, over
        one timestep.

        Returns the squared distance (m2) of the tip from its commanded place after every physics
        step; the arm is then told to hold. Raises ReachError before anything moves.
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
        """``world_T_obj_N44`` now; until time passes, exactly the poses given to ``reset``.

        Exactly, because contact amplifies the last bit of a start: an episode could not be replayed
        otherwise.
        """
        if self._is_fresh:
            return self._placed[0]
        poses = [
            get_pose(self._bullet, body_id, obj_T_com)
            for body_id, obj_T_com in zip(self._ids[FIRST_OBJECT:], self._obj_T_com, strict=True)
        ]
        return np.array(poses).reshape(-1, 4, 4)

    def clear_contacts(self) -> None:
        """Forget which things touched."""
        self._touched = np.zeros((len(self._ids), len(self._ids)), dtype=bool)

    def step(self, t_ns: int, cameras: tuple[Camera, ...]) -> Step:
        """The state now; the contacts are those since the last ``clear_contacts``."""
        poses = self.poses()
        boxes = [
            true_box(self.catalogue.meshes[body.mesh], body, pose)
            for body, pose in zip(self.bodies, poses, strict=True)
        ]
        return Step(
            t_ns=t_ns,
            world_T_obj_N44=poses,
            center_N3=np.array([center for center, _ in boxes]).reshape(-1, 3),
            size_N3=np.array([size for _, size in boxes]).reshape(-1, 3),
            tip_world_3=self._tip(),
            joints_rad_J=np.zeros(0) if self._arm is None else self._arm.joints(),
            world_T_link_L44=np.zeros((0, 4, 4)) if self._arm is None else self._arm.world_T_link(),
            contact_AA=self.touched(),
            cameras=cameras,
        )

    def touched(self) -> NDArray[np.bool_]:
        """MM: which of table, robot and objects touched which since the last ``clear_contacts``."""
        return self._touched.copy()

    def _tip(self) -> Floats:
        if self._arm is None:
            return np.full(3, np.nan)
        return (
            self._placed[1] if self._is_fresh and self._placed[1] is not None else self._arm.tip()
        )

    def _advance(self) -> None:
        self._is_fresh = False
        self._bullet.stepSimulation()
        for contact in self._bullet.getContactPoints():
            if contact[9] > 0.0:  # normal force: a pair can be listed while still apart
                a, b = self._thing_of[contact[1]], self._thing_of[contact[2]]
                self._touched[a, b] = self._touched[b, a] = True

    def _empty(self) -> None:
        self._bullet.resetSimulation()
        self._bullet.setGravity(0, 0, -GRAVITY_M_S2)
        self._bullet.setPhysicsEngineParameter(
            fixedTimeStep=self.cfg.physics.step_ms / 1000,
            numSolverIterations=self.cfg.physics.solver_iterations,
            deterministicOverlappingPairs=1,
            enableFileCaching=0,
        )

    def _table(self) -> int:
        size = np.array(self.cfg.physics.table_size_m)
        shape = self._bullet.createCollisionShape(
            self._bullet.GEOM_BOX, halfExtents=(size / 2).tolist()
        )
        table = self._bullet.createMultiBody(0, shape, basePosition=[0, 0, -size[2] / 2])
        self._bullet.changeDynamics(
            table, -1, lateralFriction=self.cfg.physics.table_friction, restitution=0.0
        )
        return int(table)

    def _load_arm(self, tip_world_3: Floats) -> RodArm:
        body = self._bullet.loadURDF(
            str(self._urdf), basePosition=self.cfg.robot.base_m, useFixedBase=True
        )
        for link_i in range(-1, self._bullet.getNumJoints(body)):
            self._bullet.changeDynamics(
                body, link_i, lateralFriction=self.cfg.physics.rod_friction, restitution=0.0
            )
        arm = RodArm(self._bullet, body, self.cfg.arm, self.cfg.robot)
        arm.reset_to(tip_world_3)
        return arm
