"""Rigid bodies that slide on a table: against what is known of them on paper, and against
Bullet.
"""

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from oes.config import load
from oes.dynamics.rigid_body.bodies import ContactPhysics, Pose, RigidBodies
from oes.dynamics.rigid_body.contact_detection import pair_touches, rod_touches
from oes.dynamics.rigid_body.sliding import outlines_of, slide
from oes.dynamics.rigid_body.substeps import GRAVITY
from oes.dynamics.train import DynamicsConfig
from oes.geom.polar import directions
from oes.sim.client import Bullet

K = 64


def physics() -> ContactPhysics:
    """That of params.yaml."""
    found = load(Path("params.yaml"), "dynamics", DynamicsConfig).pushing.net.contact.physics
    assert found is not None
    return found


def discs(
    *places: tuple[float, float], radius_m: float = 0.03, tall_m: float = 0.04
) -> tuple[RigidBodies, Pose]:
    """Equal discs, at rest."""
    num = len(places)
    outline_1NK = torch.full((1, num, K), radius_m)
    one_1N = torch.ones(1, num)
    inertia = radius_m**2 / 4 + tall_m**2 / 12
    bodies = RigidBodies(
        rod_BNK=outline_1NK,
        whole_BNK=outline_1NK,
        mass_BN2=torch.zeros(1, num, 2),
        feet_BNM2=(directions(16) * radius_m).expand(1, num, 16, 2),
        height_BN=one_1N * tall_m / 2,
        rod_low_BNK=torch.full((1, num, K), -tall_m / 2),
        rod_high_BNK=torch.full((1, num, K), tall_m / 2),
        inverse_BN33=torch.diag(torch.tensor([1 / inertia, 1 / inertia, 2 / radius_m**2])).expand(
            1, num, 3, 3
        ),
        tall_BN=one_1N * tall_m,
        heavy_BN=one_1N,
        rough_BN=one_1N,
        valid_BN=one_1N.bool(),
    )
    return bodies, Pose(torch.tensor([places]), torch.zeros(1, num), torch.zeros(1, num, 3))


def away(cfg: ContactPhysics) -> tuple[torch.Tensor, torch.Tensor, ContactPhysics]:
    """A rod that touches nothing."""
    return torch.tensor([[5.0, 5.0]]), torch.zeros(1, 2), cfg


def test_what_slides_is_stopped_by_friction_after_the_length_of_the_textbook() -> None:
    cfg = replace(physics(), parts=100)
    bodies, pose = discs((0.0, 0.0))
    speed = 0.5
    after = slide(bodies, replace(pose, twist_BN3=torch.tensor([[[speed, 0.0, 0.0]]])), *away(cfg))
    assert float(after.place_BN2[0, 0, 0]) == pytest.approx(
        speed**2 / (2 * GRAVITY * cfg.table_friction), rel=0.05
    )
    assert after.twist_BN3.abs().max() < 1e-3 and float(after.turn_BN.abs().max()) < 1e-5


@pytest.mark.parametrize(("speed", "omega"), [(0.5, 0.0), (0.0, 10.0), (0.3, 5.0)])
def test_what_slides_and_spins_comes_to_rest_where_it_does_in_bullet(
    speed: float, omega: float
) -> None:
    """Bodies rattle over the table, as Bullet keeps few contacts of each: the same way within a
    fifth of a turn's.
    """
    cfg, (bodies, pose) = physics(), discs((0.0, 0.0))
    after = slide(
        bodies, replace(pose, twist_BN3=torch.tensor([[[speed, 0.0, omega]]])), *away(cfg)
    )
    way_m, turn_rad = in_bullet(cfg, bodies, speed, omega)
    assert float(after.place_BN2[0, 0, 0]) == pytest.approx(way_m, rel=0.05, abs=1e-3)
    assert float(after.turn_BN) == pytest.approx(turn_rad, rel=0.2, abs=0.03)


def in_bullet(
    cfg: ContactPhysics, bodies: RigidBodies, speed: float, omega: float
) -> tuple[float, float]:
    """How far a disc of 16 corners slides and turns in Bullet."""
    radius_m, tall_m, mass_kg = 0.03, 0.04, 0.25
    bullet = Bullet()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "disc.obj"
        trimesh.creation.cylinder(radius_m, tall_m, sections=16).export(path)
        bullet.setGravity(0, 0, -GRAVITY)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=cfg.step_s / cfg.parts, numSolverIterations=60
        )
        box = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=[0.3, 0.3, 0.025])
        bullet.changeDynamics(
            bullet.createMultiBody(0, box, basePosition=[0, 0, -0.025]), -1, lateralFriction=1.0
        )
        shape = bullet.createCollisionShape(bullet.GEOM_MESH, fileName=str(path))
        disc = bullet.createMultiBody(mass_kg, shape, basePosition=[0, 0, tall_m / 2 + 0.001])
        moments = (mass_kg / bodies.inverse_BN33[0, 0].diagonal()).tolist()
        friction = {"lateralFriction": cfg.table_friction, "spinningFriction": cfg.spinning_m}
        bullet.changeDynamics(
            disc, -1, localInertiaDiagonal=moments, linearDamping=0, angularDamping=0, **friction
        )
        for moment in range(2 * cfg.parts):
            if moment == cfg.parts:  # settled
                start, first = bullet.getBasePositionAndOrientation(disc)
                bullet.resetBaseVelocity(disc, [speed, 0, 0], [0, 0, omega])
            bullet.stepSimulation()
        end, last = bullet.getBasePositionAndOrientation(disc)
        yaws = [bullet.getEulerFromQuaternion(quat)[2] for quat in (first, last)]
    bullet.disconnect()
    return end[0] - start[0], yaws[1] - yaws[0]


def test_a_push_through_the_middle_ends_with_the_rod_at_the_edge() -> None:
    cfg, (bodies, pose) = physics(), discs((0.0, 0.0))
    after = slide(bodies, pose, torch.tensor([[-0.05, 0.0]]), torch.tensor([[0.06, 0.0]]), cfg)
    contact_m = 0.03 + cfg.rod_radius_m + cfg.margin_m
    assert float(after.place_BN2[0, 0, 0]) >= 0.01 + contact_m - 1e-4, (
        "it may slide on, but the rod is not in it"
    )
    assert (
        after.place_BN2[0, 0, 0] < 0.01 + contact_m + 0.03
        and abs(float(after.place_BN2[0, 0, 1])) < 1e-5
    )


def test_a_push_left_of_the_middle_turns_an_object_to_the_right() -> None:
    cfg, (bodies, pose) = physics(), discs((0.0, 0.0))
    square = 0.03 / directions(K).abs().amax(-1)
    bodies = replace(bodies, rod_BNK=square.expand(1, 1, K), whole_BNK=square.expand(1, 1, K))
    turns = []
    for aside in (-0.015, 0.0, 0.015):
        after = slide(
            bodies, pose, torch.tensor([[-0.045, aside]]), torch.tensor([[0.03, 0.0]]), cfg
        )
        turns.append(float(after.turn_BN))
    assert (
        turns[2] < -0.1 and turns[0] == pytest.approx(-turns[2], rel=0.02) and abs(turns[1]) < 0.03
    )


def test_a_struck_disc_hands_on_half_of_its_speed_and_momentum_is_kept() -> None:
    """Inelastic, head on, without friction: both go on at half the speed."""
    cfg = replace(physics(), table_friction=1e-6, object_friction=0.0, margin_m=0.0)
    bodies, pose = discs((0.0, 0.0), (0.08, 0.0))
    pose = replace(pose, twist_BN3=torch.tensor([[[0.3, 0.0, 0.0], [0.0, 0.0, 0.0]]]))
    after = slide(bodies, pose, *away(cfg))
    assert after.twist_BN3[0, :, 0].tolist() == pytest.approx([0.15, 0.15], rel=0.02)
    heavy = slide(replace(bodies, heavy_BN=torch.tensor([[1.0, 3.0]])), pose, *away(cfg))
    assert heavy.twist_BN3[0, :, 0].tolist() == pytest.approx([0.075, 0.075], rel=0.03)


def test_overlapping_objects_are_parted_and_far_ones_left_alone() -> None:
    cfg = physics()
    bodies, pose = discs((0.0, 0.0), (0.055, 0.0), (0.3, 0.3))
    after = slide(bodies, pose, *away(cfg))
    assert (
        0.0595 < float((after.place_BN2[0, 1] - after.place_BN2[0, 0]).norm()) < 0.06 + cfg.margin_m
    )
    assert after.place_BN2[0, 2].tolist() == pose.place_BN2[0, 2].tolist()
    assert after.twist_BN3.abs().max() < 1e-3, "parting gives no speed"


def test_touches_tell_where_and_how_far() -> None:
    """Of the rod: where on the body, the normal towards it, the gap; of pairs: also where from the
    other's centre.
    """
    bodies, pose = discs((0.1, 0.0), (0.1, 0.07), (0.3, 0.3))
    outlines, rod_m, tip_m = outlines_of(bodies), 0.01, 0.018
    place_BN3 = torch.cat([pose.place_BN2, bodies.height_BN[..., None]], -1).double().numpy()
    turn_BN33 = np.broadcast_to(np.eye(3), (1, 3, 3, 3)).copy()
    beside, inside = (
        rod_touches(outlines, place_BN3, turn_BN33, np.array([[x, 0.0]]), rod_m, tip_m)[0]
        for x in (0.055, 0.08)
    )
    assert beside[0] == pytest.approx(
        [-0.03, 0, tip_m - 0.02, 1, 0, 0, 0.045 - 0.03 - rod_m], abs=1e-5
    )
    assert inside[0, 6] == pytest.approx(-0.01 - rod_m, abs=1e-4) and beside[2, 6] == math.inf
    flat_BN3 = torch.cat([pose.place_BN2, pose.turn_BN[..., None]], -1).double().numpy()
    pairs = pair_touches(
        outlines, flat_BN3, bodies.height_BN.double().numpy(), 0.002, outlines.is_there_BN
    )[0]
    assert pairs[0, 1] == pytest.approx([0, -1, 0, 0.03, 0, 0, -0.04, 0, 0.01 - 0.002], abs=1e-4)
    assert pairs[1, 0] == pytest.approx([0, 1, 0, -0.03, 0, 0, 0.04, 0, 0.01 - 0.002], abs=1e-4)
    assert pairs[0, 0, 8] == pairs[0, 2, 8] == math.inf, (
        "nothing touches itself, or what is far away"
    )


def test_a_world_turned_by_whole_directions_slides_as_the_world_did() -> None:
    cfg = physics()
    bodies, pose = discs((0.0, 0.0), (0.062, 0.02))
    ends = []
    for turn in (0.0, 11 * 2 * math.pi / K):
        R = torch.tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        there = replace(pose, place_BN2=pose.place_BN2 @ R.T)
        end = slide(
            bodies,
            there,
            torch.tensor([[-0.05, 0.004]]) @ R.T,
            torch.tensor([[0.06, 0.0]]) @ R.T,
            cfg,
        )
        ends.append(end.place_BN2 @ R)
    np.testing.assert_allclose(
        ends[0], ends[1], atol=3e-3, err_msg="what rattles is chaotic, but no more than that"
    )
    assert (ends[0] - pose.place_BN2).norm(dim=-1).min() > 0.01, "both were pushed"


def test_what_rests_and_is_not_touched_stays_to_the_last_bit() -> None:
    cfg, (bodies, pose) = physics(), discs((0.0, 0.0), (0.0, 0.1))
    after = slide(bodies, pose, torch.tensor([[-0.05, 0.0]]), torch.tensor([[0.05, 0.0]]), cfg)
    assert after.place_BN2[0, 0, 0] > 0.01 and torch.equal(
        after.place_BN2[0, 1], pose.place_BN2[0, 1]
    )
    assert float(after.turn_BN[0, 1]) == 0 and (after.twist_BN3[0, 1] == 0).all()


def test_what_rests_elsewhere_changes_nothing_of_a_push_to_the_last_bit() -> None:
    """Though what rests is solved only where something comes near: the second is struck, the others
    are not.
    """
    push = torch.tensor([[-0.05, 0.003]]), torch.tensor([[0.06, 0.0]]), physics()
    alone = slide(*discs((0.0, 0.0), (0.075, 0.0)), *push)
    among = slide(*discs((0.0, 0.0), (0.2, 0.2), (0.075, 0.0), (0.265, 0.2)), *push)
    assert float(alone.place_BN2[0, 1, 0]) > 0.08
    for name in vars(alone):
        assert torch.equal(getattr(alone, name), getattr(among, name)[:, [0, 2]]), name


def test_scenes_shared_out_among_threads_end_as_those_of_one() -> None:
    cfg, (bodies, pose), count = physics(), discs((0.0, 0.0), (0.07, 0.02)), 40
    many, poses = (
        replace(x, **{name: part.expand(count, *part.shape[1:]) for name, part in vars(x).items()})
        for x in (bodies, pose)
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
            ends.append(slide(many, poses, tip_B2, action_B2, cfg))
    finally:
        torch.set_num_threads(before)
    for name, value in vars(ends[0]).items():
        assert torch.equal(value, getattr(ends[1], name)), name
