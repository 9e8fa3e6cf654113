"""Errors of known forecasts: perfect, static, and about a point beside the true centre."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from oes.config import load
from oes.dynamics.reference_models import Simulator, Static
from oes.episode import TASKS, Episode, Floats
from oes.evaluation.evaluate_forecasts import MeshGeometry, error_rows
from oes.evaluation.forecasters import (
    ModelForecaster,
    PerceivedScene,
    RolloutsConfig,
    SimulatorForecaster,
    to_gt_objects,
    true_forecast,
)
from oes.evaluation.penetration import PenetrationMeter
from oes.objects import Objects
from oes.perception.objects_file import ObjectStore, Observation, pack, read_objects, write_objects
from oes.perception.observations import ObjectsConfig
from oes.sim.simulate import EpisodesConfig, simulate
from tests.architecture import PROFILES
from tests.blocks import make_catalogue
from tests.factories import make_episode
from tests.test_dynamics_models import make_objects

ROOT = Path(__file__).parents[1]
CFG = load(ROOT / "params.yaml", "rollouts", RolloutsConfig)
SURFACES = {f"mesh_{i}": trimesh.creation.icosphere(2, 0.04).vertices for i in range(2)}


class NoPenetration(PenetrationMeter):
    """A meter that finds no penetration."""

    def __init__(self) -> None:
        pass

    def depths_mm(self, episode: Episode, world_T_obj_TN44: Floats) -> Floats:
        return np.zeros(world_T_obj_TN44.shape[:2])


def truth_for(num: int) -> tuple[torch.Tensor, torch.Tensor]:
    return torch.zeros(num, 6, 32), torch.zeros(num, 3)


def make_scene(episode: Episode, truth: list[int], beside_m: float = 0.0) -> PerceivedScene:
    center = (
        np.array([episode.steps[0].center_N3[i] if i >= 0 else np.zeros(3) for i in truth]).reshape(
            -1, 3
        )
        + beside_m
    )
    objects = Objects(**{k: v[0] for k, v in vars(make_objects(scenes=1, num=len(truth))).items()})
    objects.center_N3.copy_(torch.from_numpy(center))
    return PerceivedScene(0, 1, objects, truth)


def motion_of(episode: Episode, scene: PerceivedScene) -> tuple[Floats, Floats]:
    """True motion of the perceived points, in the order of perception; none for false positives."""
    center_N3 = scene.objects.center_N3.double().numpy()
    found = true_forecast(
        episode, center_N3[[scene.truth.index(i) for i in range(len(episode.bodies))]]
    )
    translation, rotation = (
        np.zeros((5, len(scene.truth), 3)),
        np.tile(np.eye(3), (5, len(scene.truth), 1, 1)),
    )
    for n, i in enumerate(scene.truth):
        if i >= 0:
            translation[:, n], rotation[:, n] = (
                found.translation_TN3[:, i],
                found.rotation_TN33[:, i],
            )
    return translation, rotation


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("task", TASKS)
def test_every_evaluated_setting_is_perceived(profile: str, task: str) -> None:
    cfg, draws = (
        load(ROOT / profile, "rollouts", RolloutsConfig),
        load(ROOT / profile, "objects", ObjectsConfig),
    )
    for split, scored in cfg.settings.items():
        assert scored and set(scored) <= set(draws.settings(task, split)), split


def test_the_true_motion_of_a_point_beside_the_centre_is_no_error() -> None:
    episode = make_episode(num_steps=6)
    scene = make_scene(episode, [1, -1, 0], beside_m=0.02)
    found = to_gt_objects(scene, episode, *motion_of(episode, scene))
    true = true_forecast(episode, episode.steps[0].center_N3)
    np.testing.assert_allclose(found.translation_TN3, true.translation_TN3, atol=1e-6)
    np.testing.assert_allclose(found.rotation_TN33, true.rotation_TN33)


def test_a_missed_object_is_forecast_to_stay() -> None:
    episode = make_episode(num_steps=6)
    scene = make_scene(episode, [1])
    found = to_gt_objects(scene, episode, np.ones((5, 1, 3)), np.tile(np.eye(3), (5, 1, 1, 1)))
    assert found.detected_N.tolist() == [False, True]
    assert not found.translation_TN3[:, 0].any()
    np.testing.assert_allclose(found.translation_TN3[:, 1], 1)


@pytest.fixture
def store(tmp_path: Path) -> ObjectStore:
    episode = make_episode(num_steps=6)
    scenes = [make_scene(episode, truth) for truth in ([0, 1], [1, -1], [])]
    draws = [Observation(0, "1view_gt", (3,), scenes[0].objects, np.array([0, 1]), truth_for(2))]
    draws += [
        Observation(
            0,
            "1view_pred",
            (3,),
            s.objects,
            np.array(s.truth, dtype=np.int64),
            truth_for(len(s.truth)),
        )
        for s in scenes[1:]
    ]
    settings = ["1view_gt", "1view_pred"]
    write_objects(tmp_path / "objects.safetensors", pack(draws, settings, 5), settings)
    return read_objects(tmp_path / "objects.safetensors")


def test_every_object_and_step_has_a_row_and_the_static_error_is_the_true_motion(
    store: ObjectStore,
) -> None:
    episode = make_episode(num_steps=6)
    rows = list(
        error_rows(
            ModelForecaster(Static()),
            store,
            {0: episode},
            MeshGeometry(SURFACES, NoPenetration()),
            ("pushing", "static", "test1"),
            CFG,
        )
    )
    assert len(rows) == 3 * 2 * 5
    true = true_forecast(episode, episode.steps[0].center_N3)
    for row in rows:
        expected = 1e3 * np.linalg.norm(true.translation_TN3[row["T"] - 1, row["object_i"]])
        assert row["translation_mm"] == pytest.approx(expected, abs=1e-3)
    assert [row["detected"] for row in rows if row["T"] == 1] == [1, 1, 0, 1, 0, 0]
    assert {(row["setting"], row["num_views"], row["num_objects"]) for row in rows} == {
        ("1view_gt", 1, 2),
        ("1view_pred", 1, 2),
    }


def test_episodes_that_are_missing_are_skipped(store: ObjectStore) -> None:
    assert (
        list(
            error_rows(
                ModelForecaster(Static()),
                store,
                {},
                MeshGeometry(SURFACES, NoPenetration()),
                ("pushing", "static", "test1"),
                CFG,
            )
        )
        == []
    )


def test_the_simulator_reproduces_an_episode_whose_mass_and_friction_are_the_means(
    tmp_path: Path,
) -> None:
    catalogue = make_catalogue(tmp_path)
    capture = load(Path(__file__).parents[1] / "params.yaml", "episodes", EpisodesConfig)
    episode = simulate(catalogue, capture, "pushing", "test1", 0)
    objects = make_scene(episode, [0]).objects
    simulator = Simulator()
    simulator.measure([episode])
    forecasts = SimulatorForecaster(simulator, catalogue, replace(CFG, num_workers=1))
    found, again = forecasts(
        [PerceivedScene(0, 1, objects, [0]), PerceivedScene(0, 3, objects, [0])], {0: episode}
    )
    true = true_forecast(episode, episode.steps[0].center_N3)
    assert found is again and np.linalg.norm(true.translation_TN3[-1, 0]) > 0.02
    np.testing.assert_allclose(found.translation_TN3, true.translation_TN3, atol=1e-4)
    simulator.friction.mul_(3)
    (other,) = SimulatorForecaster(simulator, catalogue, replace(CFG, num_workers=1))(
        [PerceivedScene(0, 1, objects, [0])], {0: episode}
    )
    assert np.abs(other.translation_TN3 - true.translation_TN3).max() > 1e-4
