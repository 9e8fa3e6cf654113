"""Composed scenes, edits of scenarios, and the measures of counterfactual futures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from oes.config import load
from oes.counterfactual.compose import DecomposedScene, PoseTable, compose, initial_poses
from oes.counterfactual.edits import (
    EDIT_TYPES,
    Scenario,
    add_object,
    draw_edit,
    move_object,
    redirect_push,
    remove_object,
    resize_object,
)
from oes.counterfactual.evaluate import FutureEvaluator, _image_errors, edit_rows
from oes.counterfactual.forecast import (
    STATIC,
    UNEDITED,
    Counterfactual,
    ObjectMotion,
    forecast_motions,
    run_counterfactuals,
    true_motions,
)
from oes.counterfactual.runner import FuturesConfig
from oes.dynamics.reference_models import Static
from oes.episode import Frames
from oes.geom.se3 import rotation_z
from oes.geom.voxels import Grid, cube
from oes.objects import Objects
from oes.perception.rays import Field
from oes.sim.simulate import EpisodesConfig, simulate
from tests.blocks import make_catalogue
from tests.test_dynamics_models import make_model, make_objects
from tests.test_evaluation_errors import make_scene

CFG = load(Path("params.yaml"), "futures", FuturesConfig)
GRID = Grid(min_m=(-0.16, -0.16, -0.02), shape=(32, 32, 16), voxel_m=0.01)
WINDOW = cube(8, 0.01)
AIR, SOLID = -2.0, 8.0


def make_boxes(count: int = 1) -> tuple[DecomposedScene, torch.Tensor]:
    """Boxes of 4 x 2 x 2 voxels, 10 cm apart, with the voxel's x as feature, and their map."""
    background = torch.zeros(2, *GRID.shape)
    background[0] = AIR
    volume, masks, center = (
        background.clone(),
        torch.zeros(count, *WINDOW.shape),
        torch.zeros(count, 3),
    )
    for n in range(count):
        box = (slice(6 + 10 * n, 10 + 10 * n), slice(15, 17), slice(2, 4))
        volume[0][box] = SOLID
        volume[1][box] = torch.arange(1.0, 5.0)[:, None, None]
        masks[n, 2:6, 3:5, 3:5] = 1
        center[n] = torch.tensor([-0.08 + 0.1 * n, 0.0, 0.01])
    return DecomposedScene(
        volume, background, GRID, Field(background[None], GRID), masks, center, WINDOW
    ), volume


def shifted(
    poses: PoseTable, shift: tuple[float, float, float], turn_rad: float = 0.0
) -> PoseTable:
    count, turn = len(poses.source_N), torch.from_numpy(rotation_z(turn_rad)).float()
    motion = ObjectMotion(torch.tensor(shift).expand(1, count, 3), turn.expand(1, count, 3, 3))
    return motion.poses(poses, 1)


def test_composing_initial_poses_gives_the_map() -> None:
    scene, volume = make_boxes(2)
    torch.testing.assert_close(compose(scene, initial_poses(2)).volume_BCXYZ[0], volume)
    torch.testing.assert_close(
        compose(scene, initial_poses(0)).volume_BCXYZ[0], scene.background_CXYZ
    )


def test_moving_an_object_by_whole_voxels_moves_its_features() -> None:
    scene, volume = make_boxes()
    result = compose(scene, shifted(initial_poses(1), (0.03, -0.02, 0.01))).volume_BCXYZ[0]
    torch.testing.assert_close(result, volume.roll((3, -2, 1), (1, 2, 3)), atol=1e-4, rtol=0)


def test_rotation_is_about_the_centre_and_scale_enlarges() -> None:
    scene, volume = make_boxes()
    turned = compose(scene, shifted(initial_poses(1), (0, 0, 0), np.pi / 2)).volume_BCXYZ[0]
    torch.testing.assert_close(
        turned[1, 7:9, 14:18, 2], volume[1, 6:10, 15:17, 2].T, atol=1e-3, rtol=0
    )
    assert (turned[0] > 0).sum() == (volume[0] > 0).sum()
    enlarged = replace(
        initial_poses(1),
        scale_N=torch.tensor([2.0]),
        translation_N3=torch.tensor([[0.0, 0.0, 0.01]]),
    )
    assert (compose(scene, enlarged).volume_BCXYZ[0, 0] > 0).sum() > 4 * (volume[0] > 0).sum()


def test_overlapping_objects_share_voxels() -> None:
    scene, volume = make_boxes(2)
    poses = replace(
        initial_poses(2), translation_N3=torch.tensor([[0.1, 0.0, 0.0], [0.0, 0.0, 0.0]])
    )
    result = compose(scene, poses).volume_BCXYZ[0]
    torch.testing.assert_close(
        result[:, 16:20, 15:17, 2:4], volume[:, 16:20, 15:17, 2:4], atol=1e-4, rtol=0
    )
    assert (result[0, 6:10] < 0).all(), "the first object is gone"


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> tuple[Scenario, tuple]:
    """Two pushed objects, perceived exactly plus one false detection, and the simulation."""
    catalogue = make_catalogue(tmp_path_factory.mktemp("meshes"))
    episode = simulate(
        catalogue, load(Path("params.yaml"), "episodes", EpisodesConfig), "pushing", "test2", 0
    )
    scenario = Scenario("as it was", episode, make_scene(episode, [1, -1, 0]), initial_poses(3))
    return scenario, (catalogue, CFG.sim, {"model": Static()})


def test_edits_change_true_and_perceived_objects_alike(world: tuple[Scenario, tuple]) -> None:
    scenario, _ = world
    window = cube(scenario.scene.objects.crop_NCXYZ.shape[-1], 0.01)
    shift = np.array([0.05, -0.02, 0.0])
    changes = {
        2: [
            move_object(scenario, 0, shift),
            resize_object(scenario, 2, 1.3, window),
            redirect_push(scenario, 0.5),
        ],
        1: [remove_object(scenario, 0), remove_object(scenario, 2)],
        3: [add_object(scenario, 2, shift)],
    }
    for count, scenarios in changes.items():
        for edited in scenarios:
            first, objects = edited.episode.steps[0], edited.scene.objects
            true = edited.episode.bodies, first.center_N3, first.world_T_obj_N44
            assert [len(x) for x in true] == [count] * 3
            perceived = objects.center_N3, edited.scene.truth, edited.poses.source_N
            assert [len(x) for x in perceived] == [count + 1] * 3
            for i, true_i in enumerate(edited.scene.truth):
                source = scenario.scene.objects.center_N3[edited.poses.source_N[i]]
                composed = source + edited.poses.translation_N3[i]
                torch.testing.assert_close(composed, objects.center_N3[i])
                if true_i >= 0:
                    expected = pytest.approx(first.center_N3[true_i], abs=1e-6)
                    assert objects.center_N3[i].numpy() == expected
    enlarged = changes[2][1]
    ratio = enlarged.episode.bodies[0].scale_3 / scenario.episode.bodies[0].scale_3
    assert ratio == pytest.approx(1.3) and float(enlarged.poses.scale_N[2]) == pytest.approx(1.3)
    radii = [x.scene.objects.radial_profile_NRD3[2, 0, :, 0] for x in (enlarged, scenario)]
    assert (radii[0] / radii[1]).numpy() == pytest.approx(1.3)
    steps = enlarged.episode.steps[0], scenario.episode.steps[0]
    bottom, original = (step.center_N3[0, 2] - step.size_N3[0, 2] / 2 for step in steps)
    assert bottom == pytest.approx(1.3 * original)
    before, after = scenario.episode.actions_T3[0], changes[2][2].episode.actions_T3[0]
    assert np.cross(before, after)[2] / (before @ before) == pytest.approx(np.sin(0.5)), (
        "further to the left"
    )


def test_true_motions_forecast_every_edit_without_error(world: tuple[Scenario, tuple]) -> None:
    scenario, parts = world
    window = cube(scenario.scene.objects.crop_NCXYZ.shape[-1], 0.01)
    futures = list(
        run_counterfactuals(
            scenario, tuple(EDIT_TYPES), CFG.edits, window, np.random.default_rng(0), parts
        )
    )
    assert [future.edit for future in futures] == [UNEDITED, *EDIT_TYPES]
    assert [len(future.simulated.bodies) for future in futures] == [2, 2, 2, 1, 3, 2]
    for future in futures:
        assert set(future.forecasts) == {STATIC, "model"}
        perfect = Counterfactual(
            future.edit,
            future.scenario,
            future.simulated,
            {"true": true_motions(future.scenario, future.simulated)},
        )
        rows = list(edit_rows(perfect, (1, 3, 5)))
        assert len(rows) == 3 * len(future.simulated.bodies)
        assert all(row["detected"] for row in rows)
        assert max(row["translation_mm"] for row in rows) < 1e-2
        assert max(row["rotation_deg"] for row in rows) < 0.02
    static = [
        row for future in futures for row in edit_rows(future, (5,)) if row["model"] == STATIC
    ]
    assert max(row["translation_mm"] for row in static) > 20.0, "something is pushed"


def test_a_scene_without_detections_is_forecast_as_static(world: tuple[Scenario, tuple]) -> None:
    scenario, _ = world
    objects = Objects(**{name: value[:0] for name, value in vars(scenario.scene.objects).items()})
    empty = replace(
        scenario, scene=replace(scenario.scene, objects=objects, truth=[]), poses=initial_poses(0)
    )
    model = make_model("oes", make_objects())
    motion = forecast_motions(empty, {"oes": model})["oes"]
    assert motion.translation_TN3.shape == (5, 0, 3)
    assert motion.rotation_TN33.shape == (5, 0, 3, 3)
    rows = list(edit_rows(Counterfactual(UNEDITED, empty, scenario.episode, {"oes": motion}), (5,)))
    assert [row["detected"] for row in rows] == [0, 0]
    assert max(row["translation_mm"] for row in rows) > 20
    scene, _ = make_boxes()
    torch.testing.assert_close(
        compose(scene, motion.poses(empty.poses, 5)).volume_BCXYZ[0], scene.background_CXYZ
    )


def test_no_edit_without_free_space_or_a_matched_object(world: tuple[Scenario, tuple]) -> None:
    scenario, _ = world
    rng, window = np.random.default_rng(0), cube(16, 0.01)
    assert draw_edit("move", scenario, replace(CFG.edits, table_edge_m=0.05), window, rng) is None
    unknown = replace(scenario, scene=replace(scenario.scene, truth=[-1, -1, -1]))
    assert draw_edit("remove", unknown, CFG.edits, window, rng) is None
    with pytest.raises(ValueError, match=r"unknown fly; valid: move, resize, remove, add, push"):
        replace(CFG, edit_types={"pushing": ("fly",)})


class Oracle:
    """A perceiver that detects objects at given positions, view by view."""

    def __init__(self, positions: list[np.ndarray]) -> None:
        self.positions = iter(positions)

    def encode(self, frames: Frames, cameras: list) -> None:
        assert len(frames.rgb_VHW3) == len(cameras) == 1

    def detect(self, scene: None) -> tuple[torch.Tensor, None, None]:
        return torch.from_numpy(next(self.positions)), None, None


def test_detections_are_measured_against_objects_and_each_other(
    world: tuple[Scenario, tuple],
) -> None:
    scenario, _ = world
    true = scenario.episode.steps[0].center_N3
    offset = np.array([0.01, 0.0, 0.0])
    positions = [true + offset, true - offset, true[:1] + offset]
    images = np.zeros((3, 4, 4, 3), np.uint8)
    frames = Frames(images, np.zeros((3, 4, 4), np.float32), images[..., 0])
    evaluator = FutureEvaluator(Oracle(positions), None, scenario, None, 0, (1, 2, 3))
    first, second = evaluator._detection_rows(
        1, "oes", frames, scenario.episode.steps[0].cameras[:3], true
    )
    assert (first["views_found"], first["centre_mm"]) == (3, 10.0)
    assert first["spread_mm"] == pytest.approx((20 + 20 + 0) / 3, abs=1e-3)
    assert (second["views_found"], second["spread_mm"]) == (2, 20.0)


def test_object_psnr_counts_object_pixels_only() -> None:
    rng = np.random.default_rng(0)
    true = rng.integers(0, 255, (2, 32, 32, 3)).astype(np.uint8)
    image = true.copy()
    image[:, :4] = 255 - image[:, :4] // 2
    is_unchanged = np.zeros((2, 32, 32), bool)
    is_unchanged[:, 8:] = True
    zeros = np.zeros((2, 32, 32))
    frames = Frames(image, zeros, zeros), Frames(true, zeros, zeros)
    row = _image_errors(*frames, ~is_unchanged)
    assert row["objects_psnr_db"] < row["psnr_db"] < 30
    assert _image_errors(*frames, zeros.astype(bool))["objects_psnr_db"] is None
