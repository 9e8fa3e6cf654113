"""Training from scenes to a file, reference models, variants, and errors of loading."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from oes.config import ParamsError, to_json
from oes.dynamics import VARIANTS
from oes.dynamics.augment import Augment
from oes.dynamics.checkpoint import (
    MODEL_FILE,
    ModelFileError,
    load_any_model,
    load_model,
    save_model,
)
from oes.dynamics.contact import Contact
from oes.dynamics.learn import ModelNameError, build_model, resolve_model, training_examples
from oes.dynamics.models import OES, GraphXYZ, GraphXYZImageFixed
from oes.dynamics.reference_models import Simulator
from oes.dynamics.train import TaskConfig, Variant
from oes.dynamics.unroll import DynamicsModel, unroll
from oes.episode import Episode
from oes.geom.se3 import transform
from oes.objects import Objects, map_tensors
from oes.training.checkpoint import TrainConfig
from tests.factories import make_episode
from tests.test_dynamics_models import INPUTS, NET, make_actions, make_model, make_objects

FIT = TrainConfig(
    steps=6,
    batch=4,
    optimizer="adamw",
    lr=1e-3,
    warmup_steps=1,
    weight_decay=0.0,
    clip=1.0,
    ema_decay=0.9,
    bfloat16=False,
    checkpoint_every_steps=3,
    log_every_steps=2,
    seed=0,
)
CFG = TaskConfig(
    observations={"random": ("train1", "train2"), "fixed": ("fixed",)},
    net=NET,
    augment=Augment(rotate=True, mirror=True, shift_sigma_m=0.004),
    weights={"translation": 1.0, "rotation": 1.0},
    smoothing=1e-4,
    unroll=True,
    validation_share=0.25,
    voxel_m=0.01,
    fit=FIT,
    fit_overrides={},
    variants={
        name: Variant(0, name != "contact_onestep", name != "contact_noaug", name == "contact_gt")
        for name in VARIANTS
    },
)
SETTINGS = ("train1", "train2", "fixed")


class Scenes:
    """Six episodes of one or two objects, each observed once in every setting."""

    def __init__(self) -> None:
        self.episodes = {
            i: make_episode(seed=i, num_steps=6, num_objects=1 + i % 2) for i in range(6)
        }

    def observations(self, setting: str) -> list[int]:
        return [SETTINGS.index(setting) * 6 + i for i in range(6)]

    def episode(self, observation_i: int) -> int:
        return observation_i % 6

    def scene(self, observation_i: int) -> tuple[Objects, Tensor]:
        num = len(self.episodes[observation_i % 6].bodies)
        objects = make_objects(scenes=1, num=num, seed=observation_i)
        return map_tensors(objects, lambda x: x[0]), torch.arange(num)

    def with_gt_surfaces(self) -> "Scenes":
        self.are_true = True
        return self


@pytest.fixture(scope="module")
def scenes() -> Scenes:
    return Scenes()


def test_examples_hold_the_true_motion_of_the_perceived_point(scenes: Scenes) -> None:
    inputs, data = training_examples(OES, CFG, scenes, scenes.episodes)
    assert inputs == INPUTS
    assert data.all.objects.crop_NCXYZ.shape == (12, 2, 2, 16, 16, 16)
    assert data.all.objects.image_NV3HW.shape[-1] == 1
    episode: Episode = scenes.episodes[1]
    body_T_world = np.linalg.inv(episode.steps[0].world_T_obj_N44[1])
    center = data.all.objects.center_N3[1, 1].double().numpy()
    at_body = transform(body_T_world, center[None])
    for t, step in enumerate(episode.steps[1:]):
        expected = transform(step.world_T_obj_N44[1], at_body)[0] - center
        np.testing.assert_allclose(data.all.translation_BTN3[1, t, 1], expected, atol=1e-5)
    assert not data.all.objects.valid_N[0, 1]


def test_no_episode_is_in_training_and_validation(scenes: Scenes) -> None:
    _, data = training_examples(OES, CFG, scenes, scenes.episodes)
    train_U, validation_U = data.split(CFG.validation_share)
    train_episodes, held_episodes = (
        set(data.episode_U[d].tolist()) for d in (train_U, validation_U)
    )
    assert held_episodes
    assert not train_episodes & held_episodes
    assert len(train_U) + len(validation_U) == 12


def test_the_fixed_camera_has_observations_of_its_own(scenes: Scenes) -> None:
    _, data = training_examples(GraphXYZImageFixed, CFG, scenes, scenes.episodes)
    assert len(data.all.tip_B3) == 6
    with pytest.raises(ValueError, match="fixed"):
        training_examples(
            GraphXYZImageFixed,
            replace(CFG, observations={"random": ("train1",)}),
            scenes,
            scenes.episodes,
        )


def test_observations_of_missing_episodes_are_ignored(scenes: Scenes) -> None:
    _, data = training_examples(GraphXYZ, CFG, scenes, {i: scenes.episodes[i] for i in (0, 3)})
    assert set(data.episode_U.tolist()) == {0, 3}


@pytest.mark.parametrize("name", ["oes", "graph_xyz_image"])
def test_a_trained_model_is_restored_from_disk(name: str, scenes: Scenes, tmp_path: Path) -> None:
    model, log = build_model(resolve_model(name, CFG), scenes, scenes.episodes, tmp_path)
    assert log[-1]["step"] == CFG.fit.steps
    assert {"translation", "rotation", "mm_5", "deg_5"} <= set(log[-1])
    save_model(tmp_path, model)
    again, objects = load_model(tmp_path), make_objects()
    assert isinstance(model, DynamicsModel)
    tip, actions = make_actions()
    with torch.no_grad():
        expected = unroll(model, objects, tip, actions).translation_BTN3
        torch.testing.assert_close(unroll(again, objects, tip, actions).translation_BTN3, expected)


def test_training_again_gives_the_same_weights(scenes: Scenes, tmp_path: Path) -> None:
    spec, runs = resolve_model("graph_xyz", CFG), []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        runs.append(build_model(spec, scenes, scenes.episodes, tmp_path / name)[0].state_dict())
    assert all(torch.equal(runs[0][name], runs[1][name]) for name in runs[0])


def test_a_variant_changes_the_training_of_its_model() -> None:
    assert resolve_model("contact", CFG).cfg == CFG
    changed = {name: resolve_model(name, CFG) for name in VARIANTS}
    assert {spec.kind for spec in changed.values()} == {Contact}
    assert changed["contact_gt"].cfg.net.contact.gt_surfaces
    assert not changed["contact_noaug"].cfg.augment.rotate
    assert not changed["contact_onestep"].cfg.unroll
    fewer = replace(CFG, variants={"contact_100": Variant(100, True, True, False)})
    assert resolve_model("contact_100", fewer).num_episodes == 100
    with pytest.raises(ModelNameError, match=r"no variant 'contact_gt'.*contact_100"):
        resolve_model("contact_gt", fewer)
    with pytest.raises(ModelNameError, match=r"unknown model 'planet'.*graph_xyz"):
        resolve_model("planet", CFG)


def test_the_simulator_takes_the_mean_of_all_bodies(scenes: Scenes, tmp_path: Path) -> None:
    model, log = build_model(resolve_model("simulator", CFG), scenes, scenes.episodes, tmp_path)
    save_model(tmp_path, model)
    again = load_any_model(tmp_path)
    assert isinstance(again, Simulator)
    bodies = [body for episode in scenes.episodes.values() for body in episode.bodies]
    assert float(again.mass_kg) == pytest.approx(np.mean([body.mass_kg for body in bodies]))
    assert float(again.friction) == pytest.approx(np.mean([body.friction for body in bodies]))
    assert log == []
    with pytest.raises(ModelFileError, match="not a forecaster"):
        load_model(tmp_path)


def test_static_is_saved_and_forecasts_rest(scenes: Scenes, tmp_path: Path) -> None:
    save_model(
        tmp_path, build_model(resolve_model("static", CFG), scenes, scenes.episodes, tmp_path)[0]
    )
    found = unroll(load_model(tmp_path), make_objects(), *make_actions())
    assert not found.translation_BTN3.any()


def test_missing_broken_and_foreign_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"model\.safetensors"):
        load_any_model(tmp_path)
    (tmp_path / MODEL_FILE).write_bytes(b"not weights")
    with pytest.raises(ModelFileError, match="not a readable safetensors file"):
        load_any_model(tmp_path)
    save_file({"x": torch.zeros(1)}, tmp_path / MODEL_FILE, {"format": "other"})
    with pytest.raises(ModelFileError, match="format is 'other'"):
        load_any_model(tmp_path)
    save_file(
        {"x": torch.zeros(1)},
        tmp_path / MODEL_FILE,
        {"format": "oes-dynamics-3", "model": "planet"},
    )
    with pytest.raises(ModelFileError, match="unknown model 'planet'"):
        load_any_model(tmp_path)


def test_weights_that_do_not_fit_their_config_are_refused(tmp_path: Path) -> None:
    save_model(tmp_path, make_model("graph_xyz", make_objects()))
    tensors = load_file(tmp_path / MODEL_FILE)
    wider = replace(NET, graph=replace(NET.graph, width=24))
    about = {
        "format": "oes-dynamics-3",
        "model": "graph_xyz",
        "net": to_json(wider),
        "inputs": to_json(INPUTS),
    }
    save_file(tensors, tmp_path / MODEL_FILE, about)
    with pytest.raises(ModelFileError, match="do not fit"):
        load_any_model(tmp_path)
    save_file(tensors, tmp_path / MODEL_FILE, about | {"net": '{"graph": 3}'})
    with pytest.raises(ParamsError, match=r"model\.safetensors"):
        load_any_model(tmp_path)
