"""Surface errors and film strips of known forecasts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from oes.config import load
from oes.episode import Episode
from oes.evaluation.evaluate_forecasts import mesh_geometry
from oes.evaluation.filmstrips import render_filmstrips
from oes.evaluation.forecasters import (
    Forecast,
    PerceivedScene,
    RolloutsConfig,
    forecast_steps,
    true_forecast,
)
from oes.metrics.errors import surface_mm
from oes.perception.objects_file import Observation, pack, read_objects, write_objects
from oes.sim.simulate import EpisodesConfig, simulate
from tests.blocks import make_catalogue
from tests.test_evaluation_errors import make_scene

CFG = load(Path("params.yaml"), "rollouts", RolloutsConfig)
TRUTH = (torch.zeros(1, 6, 32), torch.zeros(1, 3))


@dataclass(frozen=True)
class KnownForecaster:
    """Forecasts the true motion, or none."""

    is_right: bool

    def __call__(
        self, scenes: Sequence[PerceivedScene], episodes: Mapping[int, Episode]
    ) -> list[Forecast]:
        true = [
            true_forecast(episodes[scene.episode_i], episodes[scene.episode_i].steps[0].center_N3)
            for scene in scenes
        ]
        still = [replace(each, translation_TN3=0 * each.translation_TN3) for each in true]
        return true if self.is_right else still


def test_the_surface_error_ignores_the_rotation_of_a_cylinder_but_not_of_a_box() -> None:
    turn_33 = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    cylinder, box = (
        trimesh.creation.cylinder(0.03, 0.08, sections=256),
        trimesh.creation.box((0.03, 0.06, 0.08)),
    )
    round_P3, flat_P3 = (
        np.asarray(trimesh.sample.sample_surface(mesh, 4000, seed=0)[0]) for mesh in (cylinder, box)
    )
    assert surface_mm((round_P3 @ turn_33.T)[None], round_P3) < 1.2
    found_mm = surface_mm(
        np.stack([flat_P3, flat_P3 @ turn_33.T, flat_P3 + np.array([0, 0, 0.2])]), flat_P3
    )
    assert found_mm[0] == 0 and found_mm[1] > 4.0 and found_mm[2] > 120.0


def test_the_film_strip_of_a_perfect_forecast_shows_the_recorded_states(tmp_path: Path) -> None:
    catalogue = make_catalogue(tmp_path / "meshes")
    capture = load(Path("params.yaml"), "episodes", EpisodesConfig)
    episode = simulate(catalogue, capture, "pushing", "test1", 0)
    (true,) = KnownForecaster(True)(
        [PerceivedScene(0, 1, make_scene(episode, [0]).objects, [0])], {0: episode}
    )
    for step, again in zip(episode.steps, forecast_steps(episode, true), strict=True):
        np.testing.assert_allclose(again.world_T_obj_N44, step.world_T_obj_N44, atol=1e-9)
    setting = CFG.filmstrips.setting
    write_objects(
        tmp_path / "objects.safetensors",
        pack(
            [Observation(0, setting, (3,), make_scene(episode, [0]).objects, np.array([0]), TRUTH)],
            [setting],
            5,
        ),
        [setting],
    )
    store = read_objects(tmp_path / "objects.safetensors")
    ((episode_i, right),) = render_filmstrips(
        KnownForecaster(True), store, {0: episode}, catalogue, CFG
    )
    ((_, wrong),) = render_filmstrips(KnownForecaster(False), store, {0: episode}, catalogue, CFG)
    side = CFG.filmstrips.size_px
    assert (episode_i, right.shape) == (0, (2 * side, 6 * side, 3))
    np.testing.assert_array_equal(right[:side], right[side:])
    assert (wrong[:side, -side:] != wrong[side:, -side:]).any()
    assert {
        name: points.shape for name, points in mesh_geometry(catalogue, 50).surfaces.items()
    } == {"block": (50, 3), "disc": (50, 3)}
