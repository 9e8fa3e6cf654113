"""The arm: closed-form inverse kinematics, and position control with velocity feed-forward.

With the rod vertical and joints 3, 5 and 7 at zero, the iiwa is a planar arm that joint 1 turns
towards the tip; its three angles follow from the law of cosines. The solution is exact, smooth
along any path and independent of the last pose, which an iterative solver's is not.
"""

import numpy as np
from numpy.typing import NDArray

from oes.config import params
from oes.episode import Floats
from oes.geom.se3 import from_quat_xyzw, rigid
from oes.sim.client import Bullet
from oes.sim.robot import FLANGE_M, NUM_JOINTS, RobotConfig

SHOULDER_M = 0.36  # base frame to joint 2, straight up
UPPER_M = 0.42  # joint 2 to joint 4
FOREARM_M = 0.40  # joint 4 to joint 6
WRIST_M = 0.081 + FLANGE_M  # joint 6 to the flange
LIMIT_RAD = np.radians([170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0])


@params
class ArmConfig:
    """Joint control: share of a position error corrected in one physics step, and torque limit."""

    position_gain: float
    max_torque_nm: float


class ReachError(ValueError):
    """A tip position outside the workspace, or beyond the arm's links and joint limits."""


def joints_for(tips_world_P3: Floats, robot: RobotConfig) -> Floats:
    """Joint angles P7 that hold the rod vertical with its tip at each position.

    Raises ReachError naming the first unreachable tip.
    """
    tips_base = tips_world_P3 - np.array(robot.base_m)
    reach = np.hypot(tips_base[:, 0], tips_base[:, 1])
    drop = tips_base[:, 2] + robot.rod_length_m + WRIST_M - SHOULDER_M
    distance = np.hypot(reach, drop)
    cos_bend = (distance**2 - UPPER_M**2 - FOREARM_M**2) / (2 * UPPER_M * FOREARM_M)
    bend = np.arccos(np.clip(cos_bend, -1, 1))
    # Of the two solutions, the one with the elbow up stays clear of the table.
    inner = np.arctan2(FOREARM_M * np.sin(bend), UPPER_M + FOREARM_M * np.cos(bend))
    upper = np.arctan2(reach, drop) - inner
    joints = np.zeros((len(tips_base), NUM_JOINTS))
    joints[:, 0] = np.arctan2(tips_base[:, 1], tips_base[:, 0])
    joints[:, 1], joints[:, 3], joints[:, 5] = upper, -bend, np.pi - upper - bend
    outside = (np.abs(tips_world_P3[:, :2]) > robot.workspace_m).any(axis=1)
    bad = outside | (np.abs(joints) > LIMIT_RAD).any(axis=1) | (np.abs(cos_bend) > 1)
    if bad.any():
        tip = tips_world_P3[bad][0].round(3)
        raise ReachError(f"the arm cannot hold its rod vertical at {tip} m (world)")
    return joints


class RodArm:
    """The arm in a Bullet client: sets and drives its joints, reads its links."""

    def __init__(self, bullet: Bullet, body: int, cfg: ArmConfig, robot: RobotConfig) -> None:
        """``body``: the loaded URDF of ``robot.write_urdf``."""
        self._bullet, self.body, self._cfg, self._robot = bullet, body, cfg, robot
        self._links = list(range(NUM_JOINTS + 1))
        self.goal_world_3 = np.full(3, np.nan)

    def reset_to(self, tip_world_3: Floats) -> None:
        """Put the rod's tip at a position, at rest, in no time. Raises ReachError."""
        joints = joints_for(tip_world_3[None], self._robot)[0]
        for joint_i, angle in enumerate(joints):
            self._bullet.resetJointState(self.body, joint_i, angle, 0.0)
        self.goal_world_3 = tip_world_3
        self.drive(joints, np.zeros(NUM_JOINTS))

    def plan(self, action_3: Floats, num_steps: int) -> tuple[Floats, Floats]:
        """Joint angles and tips (num_steps + 1 rows each) along a line at constant speed.

        It starts at the last commanded tip, not at the measured one, so that tracking errors do not
        accumulate over actions. Raises ReachError.
        """
        fraction: NDArray[np.float64] = np.linspace(0.0, 1.0, num_steps + 1)
        tips = self.goal_world_3 + fraction[:, None] * action_3
        return joints_for(tips, self._robot), tips

    def drive(self, joints_7: Floats, speed_7: Floats) -> None:
        """Command of the next physics step: target angles (rad) and feed-forward speed (rad/s)."""
        self._bullet.setJointMotorControlArray(
            self.body,
            self._links[:NUM_JOINTS],
            self._bullet.POSITION_CONTROL,
            targetPositions=joints_7.tolist(),
            targetVelocities=speed_7.tolist(),
            forces=[self._cfg.max_torque_nm] * NUM_JOINTS,
            positionGains=[self._cfg.position_gain] * NUM_JOINTS,
            velocityGains=[1.0] * NUM_JOINTS,
        )

    def tip(self) -> Floats:
        """Position of the rod's tip (3), world."""
        state = self._bullet.getLinkState(self.body, NUM_JOINTS, computeForwardKinematics=True)
        return np.array(state[4])

    def joints(self) -> Floats:
        """The seven joint angles (rad)."""
        states = self._bullet.getJointStates(self.body, self._links[:NUM_JOINTS])
        return np.array([state[0] for state in states])

    def world_T_link(self) -> Floats:
        """Frames L44 of the base, the seven links and the rod, as used by ``RobotShape``."""
        states = self._bullet.getLinkStates(self.body, self._links, computeForwardKinematics=True)
        rotation = from_quat_xyzw(np.array([state[5] for state in states]))
        links = rigid(rotation, np.array([state[4] for state in states]))
        base = rigid(np.eye(3), np.array(self._robot.base_m))
        return np.concatenate([base[None], links])
