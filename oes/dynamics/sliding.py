"""Objects that slide on a table, pushed by a rod and by each other, seen from above: rigid bodies in the plane.

Each is an outline with a centre of mass, a radius of gyration and points that it stands on. A step of the robot is
many short ones; in each, the table's friction slows what slides (Coulomb's law at every point of support, implicitly),
contacts give impulses within the cone of friction so that nothing approaches what it touches, all move, and what
overlaps is parted. As in Bullet, whose world this forecasts, contacts are inelastic. Everything is batched over scenes,
objects and points; no gradient runs through it.
"""

import torch
from torch import Tensor

from oes.dynamics.bodies import Bodies, Physics, Pose, cross, turned
from oes.dynamics.touch import Touch, pair_touch, rod_touch

GRAVITY = 9.81
SLOW_M_S = 1e-3
LEAST_SPREAD_M2 = 1e-5


def slide(bodies: Bodies, pose: Pose, tip_B2: Tensor, action_B2: Tensor, cfg: Physics) -> Pose:
    """Where objects are after the rod has gone from ``tip_B2`` by ``action_B2`` (metres) in ``cfg.step_s`` seconds."""
    h, velocity_B2 = cfg.step_s / cfg.parts, action_B2 / cfg.step_s
    for part in range(cfg.parts):
        rod_B2 = tip_B2 + velocity_B2 * (h * (part + 1))
        pose = _slowed(bodies, pose, h, cfg)
        for _ in range(cfg.rounds):
            pose = _impulses(bodies, pose, rod_B2 - velocity_B2 * h, velocity_B2, h, cfg)
        pose = _moved(pose, pose.twist_BN3 * h)
        for _ in range(cfg.rounds):
            pose = _parted(bodies, pose, rod_B2, cfg)
    return pose


def _slowed(bodies: Bodies, pose: Pose, h: float, cfg: Physics) -> Pose:
    """Velocities after ``h`` seconds of the table's friction: two rounds of reweighted least squares towards the
    minimiser of kinetic energy lost plus dissipation."""
    twist_BN3 = pose.twist_BN3
    forward_BN2 = twist_BN3[..., :2] / twist_BN3[..., :2].norm(dim=-1, keepdim=True).clamp(min=SLOW_M_S)
    arm_BNM2 = turned(bodies.support_BNM2, pose.turn_BN[..., None])
    load_BNM = _loads(arm_BNM2, bodies.share_BNM, forward_BN2 * cfg.lean_m)
    inertia_BN = bodies.gyration_BN.square()
    strength_BNM = load_BNM * (h * GRAVITY * cfg.table_friction * bodies.rough_BN)[..., None]
    found_BN3 = twist_BN3
    for _ in range(2):
        x_BNM = found_BN3[..., None, 0] - found_BN3[..., None, 2] * arm_BNM2[..., 1]
        y_BNM = found_BN3[..., None, 1] + found_BN3[..., None, 2] * arm_BNM2[..., 0]
        drag_BNM = strength_BNM / torch.hypot(x_BNM, y_BNM).clamp(min=SLOW_M_S)
        found_BN3 = _braked(twist_BN3, drag_BNM, arm_BNM2, inertia_BN)
    return Pose(pose.place_BN2, pose.turn_BN, found_BN3)


def _braked(twist_BN3: Tensor, drag_BNM: Tensor, arm_BNM2: Tensor, inertia_BN: Tensor) -> Tensor:
    """Velocities after viscous drag at the points of support: the 3 x 3 system solved by eliminating translation."""
    all_BN = 1 + drag_BNM.sum(-1)
    side_BN2 = (drag_BNM[..., None] * arm_BNM2).sum(-2)
    spin_BN = inertia_BN + (drag_BNM * arm_BNM2.square().sum(-1)).sum(-1)
    vx, vy, omega = twist_BN3.unbind(-1)
    rest_BN = spin_BN - side_BN2.square().sum(-1) / all_BN
    new_BN = (inertia_BN * omega + (side_BN2[..., 1] * vx - side_BN2[..., 0] * vy) / all_BN) / rest_BN
    new_x = (vx + side_BN2[..., 1] * new_BN) / all_BN
    new_y = (vy - side_BN2[..., 0] * new_BN) / all_BN
    return torch.stack([new_x, new_y, new_BN], -1)


def _loads(arm_BNM2: Tensor, share_BNM: Tensor, ahead_BN2: Tensor) -> Tensor:
    """Shares BNM of the weight on points of support: as ``share_BNM`` but for a slope over them that brings their
    centre to ``ahead_BN2`` from the centre of mass, as balance demands (as far as none is pulled down)."""
    middle_BN2 = (share_BNM[..., None] * arm_BNM2).sum(-2)
    around_BNM2 = arm_BNM2 - middle_BN2[..., None, :]
    xx, yy = (share_BNM[..., None] * around_BNM2.square()).sum(-2).add(LEAST_SPREAD_M2).unbind(-1)
    xy = (share_BNM * around_BNM2.prod(-1)).sum(-1)
    to_x, to_y = (ahead_BN2 - middle_BN2).unbind(-1)
    slope_BN2 = torch.stack([yy * to_x - xy * to_y, xx * to_y - xy * to_x], -1) / (xx * yy - xy.square())[..., None]
    load_BNM = share_BNM * (1 + (around_BNM2 * slope_BN2[..., None, :]).sum(-1)).clamp(min=0)
    return load_BNM / load_BNM.sum(-1, keepdim=True).clamp(min=1e-6)


def _impulses(bodies: Bodies, pose: Pose, rod_B2: Tensor, rod_velocity_B2: Tensor, h: float, cfg: Physics) -> Pose:
    """Velocities such that nothing approaches what it touches: the rod first, then each other."""
    touch, inertia_BN = rod_touch(bodies, pose, rod_B2, cfg), bodies.gyration_BN.square()
    relative_BN2 = _at(pose.twist_BN3, touch.lever_2) - rod_velocity_B2[:, None]
    closing_BN = (relative_BN2 * touch.normal_2).sum(-1) - touch.gap.clamp(min=0) / h
    push_BN2 = _impulse(closing_BN, relative_BN2, touch, 1 + 0 * inertia_BN, inertia_BN, cfg.rod_friction)
    twist_BN3 = pose.twist_BN3 + _kick(push_BN2, touch.lever_2, inertia_BN)
    if pose.turn_BN.shape[1] == 1:
        return Pose(pose.place_BN2, pose.turn_BN, twist_BN3)
    touch, other_BNN2 = pair_touch(bodies, pose)
    relative_BNN2 = _at(twist_BN3[:, :, None], touch.lever_2) - _at(twist_BN3[:, None], other_BNN2)
    closing_BNN = (relative_BNN2 * touch.normal_2).sum(-1) - touch.gap.clamp(min=0) / h
    return Pose(
        pose.place_BN2, pose.turn_BN, _collided(bodies, twist_BN3, touch, other_BNN2, relative_BNN2, closing_BNN, cfg)
    )


def _collided(
    bodies: Bodies,
    twist_BN3: Tensor,
    touch: Touch,
    other_BNN2: Tensor,
    relative_BNN2: Tensor,
    closing_BNN: Tensor,
    cfg: Physics,
) -> Tensor:
    """Velocities BN3 after the impulses of pairs; a pair that touches twice gets half of each."""
    inverse_BN, inertia_BN = 1 / bodies.heavy_BN, bodies.gyration_BN.square()
    soft_BNN = _softness(touch.normal_2, touch.lever_2, inverse_BN[:, :, None], inertia_BN[:, :, None])
    soft_BNN = soft_BNN + _softness(touch.normal_2, other_BNN2, inverse_BN[:, None], inertia_BN[:, None])
    push_BNN = closing_BNN.clamp(min=0) / soft_BNN
    along_BNN2 = torch.stack([-touch.normal_2[..., 1], touch.normal_2[..., 0]], -1)
    slip_BNN = (relative_BNN2 * along_BNN2).sum(-1)
    rub_BNN = -(slip_BNN / soft_BNN).clamp(-cfg.object_friction * push_BNN, cfg.object_friction * push_BNN)
    impulse_BNN2 = rub_BNN[..., None] * along_BNN2 - push_BNN[..., None] * touch.normal_2
    twice_BNN = (push_BNN > 0).float()
    impulse_BNN2 = impulse_BNN2 / (twice_BNN + twice_BNN.mT).clamp(min=1)[..., None]
    on_first = _kick(impulse_BNN2 * inverse_BN[:, :, None, None], touch.lever_2, inertia_BN[:, :, None]).sum(2)
    on_second = _kick(-impulse_BNN2 * inverse_BN[:, None, :, None], other_BNN2, inertia_BN[:, None]).sum(1)
    return twist_BN3 + on_first + on_second


def _impulse(
    closing: Tensor, relative_2: Tensor, touch: Touch, inverse: Tensor, inertia: Tensor, friction: float
) -> Tensor:
    """Impulse over mass ...2 on a body from something immovable: no approach, and no slip as far as friction holds."""
    push = closing.clamp(min=0) / _softness(touch.normal_2, touch.lever_2, inverse, inertia)
    along_2 = torch.stack([-touch.normal_2[..., 1], touch.normal_2[..., 0]], -1)
    slip = (relative_2 * along_2).sum(-1) / _softness(along_2, touch.lever_2, inverse, inertia)
    rub = -slip.clamp(-friction * push, friction * push)
    return rub[..., None] * along_2 - push[..., None] * touch.normal_2


def _softness(direction_2: Tensor, lever_2: Tensor, inverse: Tensor, inertia: Tensor) -> Tensor:
    """How much a unit impulse along a direction changes the velocity of its point in that direction."""
    return inverse * (1 + cross(lever_2, direction_2).square() / inertia)


def _at(twist_3: Tensor, lever_2: Tensor) -> Tensor:
    """Velocity ...2 of a body's point."""
    spin = twist_3[..., 2]
    return twist_3[..., :2] + torch.stack([-spin * lever_2[..., 1], spin * lever_2[..., 0]], -1)


def _kick(impulse_2: Tensor, lever_2: Tensor, inertia: Tensor) -> Tensor:
    """Change ...3 of velocity by an impulse over mass."""
    return torch.cat([impulse_2, (cross(lever_2, impulse_2) / inertia)[..., None]], -1)


def _moved(pose: Pose, by_BN3: Tensor) -> Pose:
    return Pose(pose.place_BN2 + by_BN3[..., :2], pose.turn_BN + by_BN3[..., 2], pose.twist_BN3)


def _parted(bodies: Bodies, pose: Pose, rod_B2: Tensor, cfg: Physics) -> Pose:
    """Places after what overlaps has been moved apart, without a change of velocity."""
    touch, inertia_BN = rod_touch(bodies, pose, rod_B2, cfg), bodies.gyration_BN.square()
    soft_BN = _softness(touch.normal_2, touch.lever_2, torch.ones_like(inertia_BN), inertia_BN)
    out_BN2 = (touch.gap.clamp(max=0) / soft_BN)[..., None] * touch.normal_2
    pose = _moved(pose, _kick(out_BN2, touch.lever_2, inertia_BN))
    if pose.turn_BN.shape[1] == 1:
        return pose
    touch, other_BNN2 = pair_touch(bodies, pose)
    soft_BNN = _softness(touch.normal_2, touch.lever_2, torch.ones_like(touch.gap), inertia_BN[:, :, None])
    soft_BNN = soft_BNN + _softness(touch.normal_2, other_BNN2, torch.ones_like(touch.gap), inertia_BN[:, None])
    overlap_BNN = -touch.gap.clamp(max=0)
    twice_BNN = (overlap_BNN > 0).float()
    step_BNN = overlap_BNN / soft_BNN / (twice_BNN + twice_BNN.mT).clamp(min=1)
    out_BNN2 = -step_BNN[..., None] * touch.normal_2
    on_first = _kick(out_BNN2, touch.lever_2, inertia_BN[:, :, None]).sum(2)
    return _moved(pose, on_first + _kick(-out_BNN2, other_BNN2, inertia_BN[:, None]).sum(1))
