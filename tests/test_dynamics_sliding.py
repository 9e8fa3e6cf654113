"""Rigid bodies that slide on a table: against what is known of them on paper, and against Bullet."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from oes.config import load
from oes.dynamics.bodies import Bodies, Physics, Pose
from oes.dynamics.sliding import GRAVITY, outlines_of, slide
from oes.dynamics.touch import pair_touches, rod_touches
from oes.dynamics.train import Tasks
from oes.geom.polar import directions, gyration

K = 64


def physics() -> Physics:
    """That of params.yaml."""
    found = load(Path("params.yaml"), "dynamics", Tasks).pushing.net.contact.physics
    assert found is not None
    return found


def discs(*places: tuple[float, float], radius_m: float = 0.03) -> tuple[Bodies, Pose]:
    """Equal discs, at rest."""
    num = len(places)
    outline_1NK = torch.full((1, num, K), radius_m)
    one_1N = torch.ones(1, num)
    bodies = Bodies(
        rod_BNK=outline_1NK,
        whole_BNK=outline_1NK,
        support_BNM2=(directions(16) * radius_m).expand(1, num, 16, 2),
        share_BNM=torch.full((1, num, 16), 1 / 16),
        mass_BN2=torch.zeros(1, num, 2),
        gyration_BN=gyration(outline_1NK),
        heavy_BN=one_1N,
        rough_BN=one_1N,
        valid_BN=one_1N.bool(),
    )
    return bodies, Pose(torch.tensor([places]), torch.zeros(1, num), torch.zeros(1, num, 3))


def away(cfg: Physics) -> tuple[torch.Tensor, torch.Tensor, Physics]:
    """A rod that touches nothing."""
    return torch.tensor([[5.0, 5.0]]), torch.zeros(1, 2), cfg


def test_what_slides_is_stopped_by_friction_after_the_length_of_the_textbook() -> None:
    cfg = replace(physics(), parts=100, lean_m=0.0)
    bodies, pose = discs((0.0, 0.0))
    speed = 0.5
    after = slide(bodies, replace(pose, twist_BN3=torch.tensor([[[speed, 0.0, 0.0]]])), *away(cfg))
    assert float(after.place_BN2[0, 0, 0]) == pytest.approx(speed**2 / (2 * GRAVITY * cfg.table_friction), rel=0.05)
    assert after.twist_BN3.abs().max() < 1e-3 and float(after.turn_BN.abs().max()) < 1e-5


def test_a_spinning_ring_of_support_is_stopped_as_a_ring_is() -> None:
    """Friction's torque is mu m g R for feet on a ring: omega falls by mu g R / gyration^2 a second."""
    cfg = replace(physics(), parts=100, lean_m=0.0)
    bodies, pose = discs((0.0, 0.0))
    omega, slowing = 10.0, cfg.table_friction * GRAVITY * 0.03 / float(bodies.gyration_BN) ** 2
    after = slide(bodies, replace(pose, twist_BN3=torch.tensor([[[0.0, 0.0, omega]]])), *away(cfg))
    assert float(after.turn_BN) == pytest.approx(omega**2 / (2 * slowing), rel=0.05)


def test_a_push_through_the_middle_ends_with_the_rod_at_the_edge() -> None:
    cfg, (bodies, pose) = physics(), discs((0.0, 0.0))
    after = slide(bodies, pose, torch.tensor([[-0.05, 0.0]]), torch.tensor([[0.06, 0.0]]), cfg)
    contact_m = 0.03 + cfg.rod_radius_m + cfg.margin_m
    assert float(after.place_BN2[0, 0, 0]) >= 0.01 + contact_m - 1e-4, "it may slide on, but the rod is not in it"
    assert after.place_BN2[0, 0, 0] < 0.01 + contact_m + 0.03 and abs(float(after.place_BN2[0, 0, 1])) < 1e-5


def test_a_push_left_of_the_middle_turns_an_object_to_the_right() -> None:
    cfg, (bodies, pose) = physics(), discs((0.0, 0.0))
    square = 0.03 / directions(K).abs().amax(-1)
    bodies = replace(bodies, rod_BNK=square.expand(1, 1, K), whole_BNK=square.expand(1, 1, K))
    turns = []
    for aside in (-0.015, 0.0, 0.015):
        after = slide(bodies, pose, torch.tensor([[-0.045, aside]]), torch.tensor([[0.03, 0.0]]), cfg)
        turns.append(float(after.turn_BN))
    assert turns[2] < -0.1 and turns[0] == pytest.approx(-turns[2], rel=0.02) and abs(turns[1]) < 1e-3


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
    assert float((after.place_BN2[0, 1] - after.place_BN2[0, 0]).norm()) == pytest.approx(0.06, abs=5e-4)
    assert after.place_BN2[0, 2].tolist() == pose.place_BN2[0, 2].tolist()
    assert after.twist_BN3.abs().max() < 1e-3, "parting gives no speed"


def test_touches_tell_where_and_how_far() -> None:
    """Outward normal, where from either centre of mass, gap."""
    bodies, pose = discs((0.1, 0.0), (0.1, 0.07), (0.3, 0.3))
    outlines, rod_m = outlines_of(bodies), 0.01
    pose_BN3 = torch.cat([pose.place_BN2, pose.turn_BN[..., None]], -1).double().numpy()
    beside, inside = (rod_touches(outlines, pose_BN3, np.array([[x, 0.0]]), rod_m)[0] for x in (0.05, 0.08))
    assert beside[0] == pytest.approx([-1, 0, -0.03, 0, 0, 0, 0.05 - 0.03 - rod_m], abs=1e-5)
    assert inside[0, 6] == pytest.approx(-0.01 - rod_m, abs=1e-4) and beside[2, 6] == math.inf
    pairs = pair_touches(outlines, pose_BN3)[0]
    assert pairs[0, 1] == pytest.approx([0, 1, 0, 0.03, 0, -0.04, 0.01], abs=1e-4)
    assert pairs[1, 0] == pytest.approx([0, -1, 0, -0.03, 0, 0.04, 0.01], abs=1e-4)
    assert pairs[0, 0, 6] == pairs[0, 2, 6] == math.inf, "nothing touches itself, or what is far away"


def test_a_world_turned_by_whole_directions_slides_as_the_world_did() -> None:
    cfg = physics()
    bodies, pose = discs((0.0, 0.0), (0.062, 0.02))
    ends = []
    for turn in (0.0, 11 * 2 * math.pi / K):
        R = torch.tensor([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        there = replace(pose, place_BN2=pose.place_BN2 @ R.T)
        end = slide(bodies, there, torch.tensor([[-0.05, 0.004]]) @ R.T, torch.tensor([[0.06, 0.0]]) @ R.T, cfg)
        ends.append(end.place_BN2 @ R)
    np.testing.assert_allclose(ends[0], ends[1], atol=5e-4)
    assert (ends[0] - pose.place_BN2).norm(dim=-1).min() > 0.01, "both were pushed"
