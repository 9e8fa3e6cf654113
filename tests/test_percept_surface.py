"""The surface head, the true outlines that it learns, and what an outline stands for."""

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
    SurfaceTraining,
    gather_objects,
    rotate_lessons,
    train_surface,
)
from oes.training.checkpoint import TrainConfig
from tests.percept_scenes import CYLINDER, SIZES, BoxWorld, box_shells, box_solids, small_network

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
LESSONS = SurfaceTraining(
    objects=48, center_jitter_m=0.0, size_jitter=0.0, scale=(1.0, 1.0), fit=FIT
)
BRICK = Body("brick", "box", np.ones(3), 0.2, 0.4, 0)


def seer() -> Perceiver:
    torch.manual_seed(0)
    return Perceiver(PerceptionNet(small_network()), torch.device("cpu"))


def brick_outline(turn: float = 0.0) -> np.ndarray:
    """A brick's true outline, its foot at the origin."""
    pose = rigid(rotation_z(turn), np.array([0.0, 0.0, SIZES["brick"][2] / 2]))
    return box_shells().outline(BRICK, pose, np.zeros(3))


def as_seen(radius_RK: np.ndarray) -> torch.Tensor:
    radius = torch.from_numpy(radius_RK).float()
    return torch.stack([radius, torch.full_like(radius, 0.001), (radius > 0).float()], -1)


@pytest.mark.parametrize("turn", [0.0, 0.4])
def test_true_outlines_are_those_of_the_turned_box_band_by_band(turn: float) -> None:
    found = brick_outline(turn)
    side_K2 = directions(CYLINDER.directions).double().numpy() @ rotation_z(turn)[:2, :2]
    box = (np.array(SIZES["brick"][:2]) / 2 / np.abs(side_K2).clip(1e-9)).min(-1)
    for row in (
        UNION,
        UPPER,
        SUPPORT,
        LAYERS,
        LAYERS + 1,
        LAYERS + 2,
    ):  # bands of 20 mm; a brick is 60 mm high
        assert found[row] == pytest.approx(box, abs=1e-4), row
    assert (found[LAYERS + 3] == 0).all()


def test_what_widens_upwards_stands_on_less_than_its_lowest_band() -> None:
    """A cup of 20 mm radius below, 50 mm above; its box is told 4 mm too low, and the foot is still
    the cup's own.
    """
    rings = [
        np.pad(r * directions(64).numpy(), ((0, 0), (0, 1)), constant_values=z)
        for r, z in ((0.02, -0.03), (0.05, 0.03))
    ]
    shells = box_shells()
    cup = SimpleNamespace(
        visual=trimesh.convex.convex_hull(np.concatenate(rings)), com_obj_3=np.zeros(3)
    )
    shells.catalogue.meshes["brick"] = cast(Mesh, cup)
    found = shells.outline(
        BRICK, rigid(np.eye(3), np.array([0.0, 0.0, 0.03])), np.array([0.0, 0.0, -0.004])
    )
    assert found[SUPPORT] == pytest.approx(0.02, abs=1e-3)
    assert found[LAYERS].min() > 0.025


def test_an_outline_stands_for_the_surface_of_its_object() -> None:
    """Bands of 20 mm and 32 directions describe a brick to a few millimetres, its lid and bottom
    included.
    """
    points_P3, normals_P3 = profile_to_point_cloud(
        as_seen(brick_outline()), CYLINDER, SIZES["brick"][2]
    )
    assert float(points_P3[:, 2].min()) == 0 and float(points_P3[:, 2].max()) == pytest.approx(0.06)
    pose = rigid(np.eye(3), np.array([0.0, 0.0, 0.03]))
    true_P3, true_normals_P3 = box_solids().surface(BRICK, pose)
    found = points_P3.double().numpy(), normals_P3.double().numpy()
    assert chamfer_mm(found[0], true_P3) < 5.0
    assert normal_deg(*found, true_P3, true_normals_P3) < 15.0
    nothing, up = profile_to_point_cloud(torch.zeros(CYLINDER.rows, 8, 3), CYLINDER, 0.06)
    assert nothing.tolist() == [[0, 0, 0]] and up.tolist() == [[0, 0, 1]]


def test_a_larger_object_has_larger_outlines_in_more_bands() -> None:
    outline = as_seen(brick_outline())
    grown, shrunk = scale_profiles(outline, 1.4), scale_profiles(outline, 0.5)
    torch.testing.assert_close(grown[UNION, :, RADIUS], 1.4 * outline[UNION, :, RADIUS])
    assert [
        int((x[LAYERS:, :, PRESENCE] > 0.5).any(-1).sum()) for x in (shrunk, outline, grown)
    ] == [1, 3, 4]
    torch.testing.assert_close(shrunk[LAYERS, :, SCALE], 0.5 * outline[LAYERS, :, SCALE])


def test_the_head_turns_with_the_world_and_mirrors_are_lessons_of_a_mirrored_world() -> None:
    net = seer().net.surface
    torch.nn.init.normal_(net.out.weight, std=0.1)
    lessons = gather_objects(seer(), BoxWorld(3), box_shells(), LESSONS, 4, range(3))
    with torch.no_grad():
        plain, after = (
            net(lessons.inputs_PCKL.float()),
            net(rotate_lessons(lessons, 5, False).inputs_PCKL.float()),
        )
    torch.testing.assert_close(after.radius_PRK, plain.radius_PRK.roll(5, -1), atol=1e-4, rtol=1e-3)
    c, s = directions(CYLINDER.directions)[5]
    turn_22 = torch.stack([torch.stack([c, -s]), torch.stack([s, c])])
    torch.testing.assert_close(
        after.mass_P3[:, :2], plain.mass_P3[:, :2] @ turn_22.T, atol=1e-5, rtol=1e-3
    )
    mirrored = rotate_lessons(lessons, 0, True)
    torch.testing.assert_close(mirrored.radius_PRK[..., 1:], lessons.radius_PRK.flip(-1)[..., :-1])
    assert mirrored.mass_P3[:, 1].tolist() == (-lessons.mass_P3[:, 1]).tolist()
    again = rotate_lessons(mirrored, 0, True)
    assert all(torch.equal(getattr(again, name), value) for name, value in vars(lessons).items())


def test_training_the_head_brings_outlines_closer_and_changes_nothing_else(tmp_path: Path) -> None:
    perceiver, world = seer(), BoxWorld(12)
    before = {name: value.clone() for name, value in perceiver.net.state_dict().items()}
    rows = train_surface(
        perceiver, world, box_shells(), LESSONS, (range(10), range(10, 12)), tmp_path
    )
    errors = [row["val_outline_mm"] for row in rows if row.get("val_outline_mm") is not None]
    assert errors[-1] < 9.0, errors
    for name, value in perceiver.net.state_dict().items():
        if not name.startswith("surface."):
            assert torch.equal(value, before[name]), name
    (tmp_path / "again").mkdir()
    other = train_surface(
        seer(), world, box_shells(), LESSONS, (range(10), range(10, 12)), tmp_path / "again"
    )
    assert other[-1]["loss"] == rows[-1]["loss"], "the same seed, the same lessons"


def test_distances_that_cannot_be_halved_so_often_are_refused() -> None:
    with pytest.raises(ValueError, match="multiple of 16 for 3 channels; found 24"):
        SurfaceHeadConfig(cylinder=CYLINDER, channels=(8, 8, 8), width=16, column=16)
