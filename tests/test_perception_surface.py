"""The surface head, ground-truth radial profiles, and point clouds of profiles."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import torch
import trimesh

from oes.episode import Body
from oes.geom.polar import directions
from oes.geom.se3 import rigid, rotation_z
from oes.meshes.catalogue import Mesh
from oes.metrics.errors import chamfer_mm, normal_deg
from oes.objects import LAYERS, SUPPORT, UNION, UPPER
from oes.perception.gt_profiles import profile_to_point_cloud
from oes.perception.network import PerceptionNet
from oes.perception.perceiver import Perceiver
from oes.perception.surface import PRESENCE, RADIUS, SCALE, SurfaceHeadConfig, scale_profiles
from oes.perception.surface_training import (
    SurfaceSampler,
    SurfaceTraining,
    rotate_batch,
    train_surface,
)
from oes.training.checkpoint import TrainConfig
from tests.perception_scenes import (
    CYLINDER,
    SIZES,
    BoxWorld,
    box_gt_profiles,
    box_solids,
    small_network,
)

FIT = TrainConfig(
    steps=60,
    batch=8,
    optimizer="muon",
    lr=3e-3,
    warmup_steps=5,
    weight_decay=0.01,
    clip=5.0,
    ema_decay=0.9,
    bfloat16=False,
    checkpoint_every_steps=60,
    log_every_steps=20,
    seed=0,
)
TRAINING = SurfaceTraining(
    num_objects=48, center_jitter_m=0.0, size_jitter=0.0, scale=(1.0, 1.0), fit=FIT
)
EPISODES = (range(10), range(10, 12))
BRICK = Body("brick", "box", np.ones(3), 0.2, 0.4, 0)


def make_perceiver() -> Perceiver:
    torch.manual_seed(0)
    return Perceiver(PerceptionNet(small_network()), torch.device("cpu"))


def brick_radii(turn: float = 0.0) -> np.ndarray:
    """Ground-truth radii of a brick that stands at the origin."""
    pose = rigid(rotation_z(turn), np.array([0.0, 0.0, SIZES["brick"][2] / 2]))
    return box_gt_profiles().radii(BRICK, pose, np.zeros(3))


def as_profile(radius_RD: np.ndarray) -> torch.Tensor:
    radius = torch.from_numpy(radius_RD).float()
    return torch.stack([radius, torch.full_like(radius, 0.001), (radius > 0).float()], -1)


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_gt_profiles_of_a_rotated_box_are_analytic_in_every_layer(turn: float) -> None:
    radius_RD = brick_radii(turn)
    unit_D2 = directions(CYLINDER.num_directions).double().numpy() @ rotation_z(turn)[:2, :2]
    box = (np.array(SIZES["brick"][:2]) / 2 / np.abs(unit_D2).clip(1e-9)).min(-1)
    # Layers of 20 mm; a brick is 60 mm high.
    for row in (UNION, UPPER, SUPPORT, LAYERS, LAYERS + 1, LAYERS + 2):
        assert radius_RD[row] == pytest.approx(box, abs=1e-4), row
    assert (radius_RD[LAYERS + 3] == 0).all()


def test_the_support_of_a_cup_is_smaller_than_its_lowest_layer() -> None:
    """Radius 20 mm at the bottom, 50 mm at the top; the box is 4 mm too low."""
    rings = [
        np.pad(r * directions(64).numpy(), ((0, 0), (0, 1)), constant_values=z)
        for r, z in ((0.02, -0.03), (0.05, 0.03))
    ]
    gt_profiles = box_gt_profiles()
    cup = SimpleNamespace(
        visual=trimesh.convex.convex_hull(np.concatenate(rings)), com_obj_3=np.zeros(3)
    )
    gt_profiles.catalogue.meshes["brick"] = cast(Mesh, cup)
    radius_RD = gt_profiles.radii(
        BRICK, rigid(np.eye(3), np.array([0.0, 0.0, 0.03])), np.array([0.0, 0.0, -0.004])
    )
    assert radius_RD[SUPPORT] == pytest.approx(0.02, abs=1e-3)
    assert radius_RD[LAYERS].min() > 0.025


def test_the_point_cloud_of_a_profile_is_close_to_the_surface() -> None:
    """A brick in layers of 20 mm and 32 directions, with its top and bottom."""
    points_P3, normals_P3 = profile_to_point_cloud(
        as_profile(brick_radii()), CYLINDER, SIZES["brick"][2]
    )
    assert float(points_P3[:, 2].min()) == 0 and float(points_P3[:, 2].max()) == pytest.approx(0.06)
    pose = rigid(np.eye(3), np.array([0.0, 0.0, 0.03]))
    true_P3, true_normals_P3 = box_solids().surface(BRICK, pose)
    cloud = points_P3.double().numpy(), normals_P3.double().numpy()
    assert chamfer_mm(cloud[0], true_P3) < 5.0
    assert normal_deg(*cloud, true_P3, true_normals_P3) < 15.0
    empty, up = profile_to_point_cloud(torch.zeros(CYLINDER.num_rows, 8, 3), CYLINDER, 0.06)
    assert empty.tolist() == [[0, 0, 0]] and up.tolist() == [[0, 0, 1]]


def test_scaled_profiles_have_scaled_radii_and_numbers_of_layers() -> None:
    profile = as_profile(brick_radii())
    grown, shrunk = scale_profiles(profile, 1.4), scale_profiles(profile, 0.5)
    torch.testing.assert_close(grown[UNION, :, RADIUS], 1.4 * profile[UNION, :, RADIUS])
    assert [
        int((x[LAYERS:, :, PRESENCE] > 0.5).any(-1).sum()) for x in (shrunk, profile, grown)
    ] == [1, 3, 4]
    torch.testing.assert_close(shrunk[LAYERS, :, SCALE], 0.5 * profile[LAYERS, :, SCALE])


def test_the_head_is_equivariant_to_rotations_and_batches_are_mirrored_with_the_world() -> None:
    net = make_perceiver().net.surface
    torch.nn.init.normal_(net.head.weight, std=0.1)
    batch = SurfaceSampler(make_perceiver(), BoxWorld(3), box_gt_profiles(), TRAINING).gather(
        4, range(3)
    )
    with torch.no_grad():
        plain = net(batch.inputs_PCDX.float())
        rotated = net(rotate_batch(batch, 5, False).inputs_PCDX.float())
    torch.testing.assert_close(
        rotated.radius_PRD, plain.radius_PRD.roll(5, -1), atol=1e-4, rtol=1e-3
    )
    c, s = directions(CYLINDER.num_directions)[5]
    R_22 = torch.stack([torch.stack([c, -s]), torch.stack([s, c])])
    torch.testing.assert_close(
        rotated.com_offset_P3[:, :2], plain.com_offset_P3[:, :2] @ R_22.T, atol=1e-5, rtol=1e-3
    )
    mirrored = rotate_batch(batch, 0, True)
    torch.testing.assert_close(mirrored.radius_PRD[..., 1:], batch.radius_PRD.flip(-1)[..., :-1])
    assert mirrored.com_offset_P3[:, 1].tolist() == (-batch.com_offset_P3[:, 1]).tolist()
    again = rotate_batch(mirrored, 0, True)
    assert all(torch.equal(getattr(again, name), value) for name, value in vars(batch).items())


def test_training_the_head_reduces_its_error_and_changes_nothing_else(tmp_path: Path) -> None:
    perceiver = make_perceiver()
    before = {name: value.clone() for name, value in perceiver.net.state_dict().items()}
    sampler = SurfaceSampler(perceiver, BoxWorld(12), box_gt_profiles(), TRAINING)
    rows = train_surface(sampler, EPISODES, tmp_path)
    errors = [row["val_union_mm"] for row in rows if row.get("val_union_mm") is not None]
    assert errors[-1] < 9.0, errors
    for name, value in perceiver.net.state_dict().items():
        if not name.startswith("surface."):
            assert torch.equal(value, before[name]), name
    (tmp_path / "again").mkdir()
    other = train_surface(
        replace(sampler, perceiver=make_perceiver()), EPISODES, tmp_path / "again"
    )
    assert other[-1]["loss"] == rows[-1]["loss"], "the same seed"


def test_a_number_of_radii_that_cannot_be_halved_for_all_channels_is_rejected() -> None:
    with pytest.raises(ValueError, match="multiple of 16 for 3 channels; found 24"):
        SurfaceHeadConfig(cylinder=CYLINDER, channels=(8, 8, 8), width=16, direction_features=16)
