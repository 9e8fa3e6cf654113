"""Rigid-body contact simulation against textbook results and against Bullet."""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from oes.config import load
from oes.dynamics.rigid_body.bodies import ContactPhysics, PlanarState, RigidBodies
from oes.dynamics.rigid_body.contact_detection import detect_pairs, detect_rod
from oes.dynamics.rigid_body.kernels import State
from oes.dynamics.rigid_body.push import compile_bodies, simulate_push
from oes.dynamics.rigid_body.substeps import GRAVITY
from oes.dynamics.train import DynamicsConfig
from oes.geom.polar import directions
from oes.sim.client import Bullet

D = 64


def physics() -> ContactPhysics:
    """That of params.yaml."""
    found = load(Path("params.yaml"), "dynamics", DynamicsConfig).pushing.net.contact.physics
    assert found is not None
    return found


def discs(
    *places: tuple[float, float], radius_m: float = 0.03, height_m: float = 0.04
) -> tuple[RigidBodies, PlanarState]:
    """Equal discs, at rest."""
    num = len(places)
    profile_1ND = torch.full((1, num, D), radius_m)
    one_1N = torch.ones(1, num)
    inertia = radius_m**2 / 4 + height_m**2 / 12
    bodies = RigidBodies(
        rod_profile_BND=profile_1ND,
        profile_BND=profile_1ND,
        com_offset_BN2=torch.zeros(1, num, 2),
        support_BNP2=(directions(16) * radius_m).expand(1, num, 16, 2),
        com_height_BN=one_1N * height_m / 2,
        rod_min_z_BND=torch.full((1, num, D), -height_m / 2),
        rod_max_z_BND=torch.full((1, num, D), height_m / 2),
        inverse_inertia_BN33=torch.diag(
            torch.tensor([1 / inertia, 1 / inertia, 2 / radius_m**2])
        ).expand(1, num, 3, 3),
        height_BN=one_1N * height_m,
        mass_factor_BN=one_1N,
        friction_factor_BN=one_1N,
        valid_BN=one_1N.bool(),
    )
    return bodies, PlanarState(torch.tensor([places]), torch.zeros(1, num), torch.zeros(1, num, 3))


def no_push(cfg: ContactPhysics) -> tuple[torch.Tensor, torch.Tensor, ContactPhysics]:
    """Arguments of a rod that stays away from all bodies."""
    return torch.tensor([[5.0, 5.0]]), torch.zeros(1, 2), cfg


def test_friction_stops_a_sliding_disc_after_the_textbook_distance() -> None:
    cfg = replace(physics(), substeps=100)
    bodies, state = discs((0.0, 0.0))
    speed = 0.5
    after = simulate_push(
        bodies, replace(state, twist_BN3=torch.tensor([[[speed, 0.0, 0.0]]])), *no_push(cfg)
    )
    assert float(after.com_BN2[0, 0, 0]) == pytest.approx(
        speed**2 / (2 * GRAVITY * cfg.table_friction), rel=0.05
    )
    assert after.twist_BN3.abs().max() < 1e-3 and float(after.yaw_BN.abs().max()) < 1e-5


@pytest.mark.parametrize(("speed", "omega"), [(0.5, 0.0), (0.0, 10.0), (0.3, 5.0)])
def test_a_sliding_spinning_disc_stops_where_it_does_in_bullet(speed: float, omega: float) -> None:
    """Contacts chatter in both simulators, so distances agree within 5% and turns within 20%."""
    cfg, (bodies, state) = physics(), discs((0.0, 0.0))
    after = simulate_push(
        bodies, replace(state, twist_BN3=torch.tensor([[[speed, 0.0, omega]]])), *no_push(cfg)
    )
    distance_m, turn_rad = in_bullet(cfg, bodies, speed, omega)
    assert float(after.com_BN2[0, 0, 0]) == pytest.approx(distance_m, rel=0.05, abs=1e-3)
    assert float(after.yaw_BN) == pytest.approx(turn_rad, rel=0.2, abs=0.03)


def in_bullet(
    cfg: ContactPhysics, bodies: RigidBodies, speed: float, omega: float
) -> tuple[float, float]:
    """Distance (m) and rotation (rad) of a sliding 16-sided disc in Bullet."""
    radius_m, height_m, mass_kg = 0.03, 0.04, 0.25
    bullet = Bullet()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "disc.obj"
        trimesh.creation.cylinder(radius_m, height_m, sections=16).export(path)
        bullet.setGravity(0, 0, -GRAVITY)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=cfg.step_s / cfg.substeps, numSolverIterations=60
        )
        box = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=[0.3, 0.3, 0.025])
        bullet.changeDynamics(
            bullet.createMultiBody(0, box, basePosition=[0, 0, -0.025]), -1, lateralFriction=1.0
        )
        shape = bullet.createCollisionShape(bullet.GEOM_MESH, fileName=str(path))
        disc = bullet.createMultiBody(mass_kg, shape, basePosition=[0, 0, height_m / 2 + 0.001])
        moments = (mass_kg / bodies.inverse_inertia_BN33[0, 0].diagonal()).tolist()
        friction = {
            "lateralFriction": cfg.table_friction,
            "spinningFriction": cfg.spinning_friction_m,
        }
        bullet.changeDynamics(
            disc, -1, localInertiaDiagonal=moments, linearDamping=0, angularDamping=0, **friction
        )
        for moment in range(2 * cfg.substeps):
            if moment == cfg.substeps:  # settled
                start, first = bullet.getBasePositionAndOrientation(disc)
                bullet.resetBaseVelocity(disc, [speed, 0, 0], [0, 0, omega])
            bullet.stepSimulation()
        end, last = bullet.getBasePositionAndOrientation(disc)
        yaws = [bullet.getEulerFromQuaternion(quat)[2] for quat in (first, last)]
    bullet.disconnect()
    return end[0] - start[0], yaws[1] - yaws[0]


def test_a_central_push_ends_with_the_rod_at_the_edge() -> None:
    cfg, (bodies, state) = physics(), discs((0.0, 0.0))
    after = simulate_push(
        bodies, state, torch.tensor([[-0.05, 0.0]]), torch.tensor([[0.06, 0.0]]), cfg
    )
    contact_m = 0.03 + cfg.rod_radius_m + cfg.contact_margin_m
    assert float(after.com_BN2[0, 0, 0]) >= 0.01 + contact_m - 1e-4, (
        "the disc may slide on, but the rod does not penetrate it"
    )
    assert (
        after.com_BN2[0, 0, 0] < 0.01 + contact_m + 0.03
        and abs(float(after.com_BN2[0, 0, 1])) < 1e-5
    )


def test_a_push_left_of_the_centre_of_mass_turns_an_object_clockwise() -> None:
    cfg, (bodies, state) = physics(), discs((0.0, 0.0))
    square = 0.03 / directions(D).abs().amax(-1)
    bodies = replace(
        bodies, rod_profile_BND=square.expand(1, 1, D), profile_BND=square.expand(1, 1, D)
    )
    turns = []
    for offset in (-0.015, 0.0, 0.015):
        after = simulate_push(
            bodies, state, torch.tensor([[-0.045, offset]]), torch.tensor([[0.03, 0.0]]), cfg
        )
        turns.append(float(after.yaw_BN))
    assert (
        turns[2] < -0.1 and turns[0] == pytest.approx(-turns[2], rel=0.02) and abs(turns[1]) < 0.03
    )


def test_an_inelastic_collision_conserves_momentum() -> None:
    """Head on, without friction: equal discs both continue at half the speed."""
    cfg = replace(physics(), table_friction=1e-6, object_friction=0.0, contact_margin_m=0.0)
    bodies, state = discs((0.0, 0.0), (0.08, 0.0))
    state = replace(state, twist_BN3=torch.tensor([[[0.3, 0.0, 0.0], [0.0, 0.0, 0.0]]]))
    after = simulate_push(bodies, state, *no_push(cfg))
    assert after.twist_BN3[0, :, 0].tolist() == pytest.approx([0.15, 0.15], rel=0.02)
    heavy = simulate_push(
        replace(bodies, mass_factor_BN=torch.tensor([[1.0, 3.0]])), state, *no_push(cfg)
    )
    assert heavy.twist_BN3[0, :, 0].tolist() == pytest.approx([0.075, 0.075], rel=0.03)


def test_penetrating_objects_are_separated_and_distant_ones_unaffected() -> None:
    cfg = physics()
    bodies, state = discs((0.0, 0.0), (0.055, 0.0), (0.3, 0.3))
    after = simulate_push(bodies, state, *no_push(cfg))
    assert (
        0.0595
        < float((after.com_BN2[0, 1] - after.com_BN2[0, 0]).norm())
        < 0.06 + cfg.contact_margin_m
    )
    assert after.com_BN2[0, 2].tolist() == state.com_BN2[0, 2].tolist()
    assert after.twist_BN3.abs().max() < 1e-3, "the correction adds no velocity"


def test_detected_contacts_have_point_normal_and_gap() -> None:
    """With the rod: point, normal, gap; of pairs: normal, point from either body, gap."""
    bodies, state = discs((0.1, 0.0), (0.1, 0.07), (0.3, 0.3))
    compiled, rod_m, tip_m = compile_bodies(bodies, physics()), 0.01, 0.018
    com_BN3 = torch.cat([state.com_BN2, bodies.com_height_BN[..., None]], -1).double().numpy()
    rotation_BN33 = np.broadcast_to(np.eye(3), (1, 3, 3, 3)).copy()
    upright = State(com_BN3, rotation_BN33, np.zeros((1, 3, 6)), np.ones((1, 3), bool))
    beside, inside = (
        detect_rod(compiled, upright, np.array([[x, 0.0]]), rod_m, tip_m)[0] for x in (0.055, 0.08)
    )
    assert beside[0] == pytest.approx(
        [-0.03, 0, tip_m - 0.02, 1, 0, 0, 0.045 - 0.03 - rod_m], abs=1e-5
    )
    assert inside[0, 6] == pytest.approx(-0.01 - rod_m, abs=1e-4) and beside[2, 6] == math.inf
    planar_BN3 = torch.cat([state.com_BN2, state.yaw_BN[..., None]], -1).double().numpy()
    pairs = detect_pairs(compiled, planar_BN3, 0.002, compiled.is_valid_BN)[0]
    assert pairs[0, 1] == pytest.approx([0, -1, 0, 0.03, 0, 0, -0.04, 0, 0.01 - 0.002], abs=1e-4)
    assert pairs[1, 0] == pytest.approx([0, 1, 0, -0.03, 0, 0, 0.04, 0, 0.01 - 0.002], abs=1e-4)
    assert pairs[0, 0, 8] == pairs[0, 2, 8] == math.inf, (
        "no contact with itself or with a distant body"
    )


def test_the_simulation_is_equivariant_to_rotation_by_whole_profile_directions() -> None:
    cfg = physics()
    bodies, state = discs((0.0, 0.0), (0.062, 0.02))
    ends = []
    for turn in (0.0, 11 * 2 * math.pi / D):
        R = torch.tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        rotated = replace(state, com_BN2=state.com_BN2 @ R.T)
        end = simulate_push(
            bodies,
            rotated,
            torch.tensor([[-0.05, 0.004]]) @ R.T,
            torch.tensor([[0.06, 0.0]]) @ R.T,
            cfg,
        )
        ends.append(end.com_BN2 @ R)
    np.testing.assert_allclose(
        ends[0], ends[1], atol=3e-3, err_msg="chattering contacts are chaotic, but bounded"
    )
    assert (ends[0] - state.com_BN2).norm(dim=-1).min() > 0.01, "both were pushed"


def test_a_sleeping_body_without_contact_stays_to_the_last_bit() -> None:
    cfg, (bodies, state) = physics(), discs((0.0, 0.0), (0.0, 0.1))
    after = simulate_push(
        bodies, state, torch.tensor([[-0.05, 0.0]]), torch.tensor([[0.05, 0.0]]), cfg
    )
    assert after.com_BN2[0, 0, 0] > 0.01 and torch.equal(after.com_BN2[0, 1], state.com_BN2[0, 1])
    assert float(after.yaw_BN[0, 1]) == 0 and (after.twist_BN3[0, 1] == 0).all()


def test_distant_sleeping_bodies_do_not_change_a_push_by_a_bit() -> None:
    """Sleeping bodies are solved only when something comes near: the second disc is hit, the others
    are not.
    """
    push = torch.tensor([[-0.05, 0.003]]), torch.tensor([[0.06, 0.0]]), physics()
    alone = simulate_push(*discs((0.0, 0.0), (0.075, 0.0)), *push)
    among = simulate_push(*discs((0.0, 0.0), (0.2, 0.2), (0.075, 0.0), (0.265, 0.2)), *push)
    assert float(alone.com_BN2[0, 1, 0]) > 0.08
    for name in vars(alone):
        assert torch.equal(getattr(alone, name), getattr(among, name)[:, [0, 2]]), name


def test_the_number_of_threads_does_not_change_the_result() -> None:
    cfg, (bodies, state), count = physics(), discs((0.0, 0.0), (0.07, 0.02)), 40
    many, states = (
        replace(x, **{name: part.expand(count, *part.shape[1:]) for name, part in vars(x).items()})
        for x in (bodies, state)
    )
    tip_B2 = torch.stack([torch.full((count,), -0.05), torch.linspace(-0.02, 0.02, count)], 1)
    action_B2, before, ends = (
        torch.tensor([[0.06, 0.0]]).expand(count, 2),
        torch.get_num_threads(),
        [],
    )
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            ends.append(simulate_push(many, states, tip_B2, action_B2, cfg))
    finally:
        torch.set_num_threads(before)
    for name, value in vars(ends[0]).items():
        assert torch.equal(value, getattr(ends[1], name)), name
