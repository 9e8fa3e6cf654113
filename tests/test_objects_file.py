"""The objects file, and the stage that writes it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from oes.meshes.catalogue import TRAIN
from oes.objects import Objects
from oes.perception.network import PerceptionNet
from oes.perception.objects_file import (
    ObjectsError,
    Observation,
    concat,
    pack,
    read_objects,
    write_objects,
)
from oes.perception.observations import TEST_SETTINGS, ObjectsConfig, ScenePerceiver, perceive_split
from oes.perception.perceiver import Perceiver
from tests.perception_scenes import BoxWorld, box_gt_profiles, box_solids, small_network

CFG = ObjectsConfig(
    seed=0,
    num_workers=2,
    fixed_camera=2,
    center_jitter_m=0.01,
    size_jitter=0.1,
    train_observations={"train1": 2, "train2": 1, "train3": 0, "fixed": 1},
    test_settings={"pushing": {"test1": ("1view_pred", "1view_gt")}},
    shard_episodes=2,
    num_solid_points=2048,
)


def random_objects(count: int, num_views: int) -> Objects:
    return Objects(
        center_N3=torch.rand(count, 3),
        size_N3=torch.rand(count, 3),
        score_N=torch.rand(count),
        valid_N=torch.ones(count, dtype=torch.bool),
        crop_NCXYZ=torch.rand(count, 3, 16, 16, 16).half().float(),
        image_NV3HW=torch.randint(0, 255, (count, num_views, 3, 32, 32), dtype=torch.uint8),
        camera_NV12=torch.rand(count, num_views, 12),
        view_NV=torch.ones(count, num_views, dtype=torch.bool),
        radial_profile_NRD3=torch.rand(count, 6, 32, 3).half().float(),
        com_offset_N3=torch.rand(count, 3),
    )


def gt_surface(count: int) -> tuple[Tensor, Tensor]:
    return torch.full((count, 6, 32), 0.03), torch.zeros(count, 3)


def make_perceiver(world: BoxWorld, *, is_train: bool) -> ScenePerceiver:
    torch.manual_seed(0)
    perceiver = Perceiver(PerceptionNet(small_network()), torch.device("cpu"))
    settings = CFG.settings("pushing", TRAIN if is_train else "test2")
    return ScenePerceiver(
        CFG, settings, perceiver, world, box_gt_profiles(), None if is_train else box_solids()
    )


def test_observations_are_read_as_written_even_those_without_objects(tmp_path: Path) -> None:
    observations = [
        Observation(4, "b", (7, 3), random_objects(2, 2), np.array([1, -1]), gt_surface(2)),
        Observation(4, "a", (5,), random_objects(0, 1), np.zeros(0, dtype=np.int64), gt_surface(0)),
        Observation(6, "b", (1,), random_objects(1, 1), np.array([0]), gt_surface(1)),
    ]
    shards = [pack(observations[:2], ["a", "b"], 3), pack(observations[2:], ["a", "b"], 3)]
    write_objects(tmp_path / "o.safetensors", concat(shards), ["a", "b"])
    store = read_objects(tmp_path / "o.safetensors")
    assert store.observations("b") == [0, 2] and store.observations("a") == [1] and len(store) == 3
    assert [store.episode(i) for i in range(3)] == [4, 4, 6] and store.views(0) == (7, 3)
    for observation_i, observation in enumerate(observations):
        objects, gt_N = store.scene(observation_i)
        num_views = len(observation.views)
        assert gt_N.tolist() == observation.gt_N.tolist()
        torch.testing.assert_close(objects.crop_NCXYZ, observation.objects.crop_NCXYZ)
        torch.testing.assert_close(
            objects.image_NV3HW[:, :num_views], observation.objects.image_NV3HW
        )
        assert objects.view_NV.sum() == len(observation.gt_N) * num_views
        assert not objects.view_NV[:, num_views:].any()
    with pytest.raises(ObjectsError, match="there are: a, b"):
        store.observations("c")


def test_invalid_objects_files_are_rejected_with_their_name(tmp_path: Path) -> None:
    path = tmp_path / "o.safetensors"
    with pytest.raises(ObjectsError, match=r"o.safetensors: not a readable"):
        read_objects(path)
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(ObjectsError, match="its format is None"):
        read_objects(path)
    tensors = pack(
        [Observation(0, "a", (1,), random_objects(2, 1), np.array([0, 1]), gt_surface(2))], ["a"], 1
    )
    write_objects(path, tensors | {"score_O": torch.zeros(1)}, ["a"])
    with pytest.raises(ObjectsError, match="do not belong together"):
        read_objects(path)


def test_training_observations_are_jittered_true_boxes_from_different_views() -> None:
    world = BoxWorld(1)
    observations, detections, predictions = make_perceiver(world, is_train=True).perceive(0)
    true = world.episodes[0].steps[0].center_N3
    settings = [observation.setting for observation in observations]
    assert settings == ["train1", "train1", "train2", "fixed"]
    first, second, pair, fixed = (observation.views for observation in observations)
    assert fixed == (2,) and first != second and len(set(pair)) == 2
    for observation in observations:
        shift = observation.objects.center_N3.numpy() - true
        assert 0 < np.abs(shift).max() < 0.05
        assert observation.gt_N.tolist() == list(range(len(true)))
    assert detections == [] and predictions == []


def test_observations_do_not_depend_on_the_other_settings_of_a_split(tmp_path: Path) -> None:
    world, all_settings = BoxWorld(1), make_perceiver(BoxWorld(1), is_train=False)
    some_settings = replace(all_settings, settings=CFG.settings("pushing", "test1"))
    assert list(CFG.settings("falling", "test1")) == list(TEST_SETTINGS)
    observations, detections, _ = some_settings.perceive(0)
    assert [observation.setting for observation in observations] == ["1view_gt", "1view_pred"]
    of_all = {observation.setting: observation for observation in all_settings.perceive(0)[0]}
    for observation in observations:
        assert observation.views == of_all[observation.setting].views
        assert torch.equal(
            observation.objects.radial_profile_NRD3,
            of_all[observation.setting].objects.radial_profile_NRD3,
        )
    assert {row["num_views"] for row in detections} == {1}
    tensors, _, _ = perceive_split(replace(some_settings, source=world), tmp_path)
    write_objects(tmp_path / "o.safetensors", tensors, list(some_settings.settings))
    with pytest.raises(ObjectsError, match="there are: 1view_gt, 1view_pred"):
        read_objects(tmp_path / "o.safetensors").observations("3views_gt")
    with pytest.raises(
        ValueError, match=r"test_settings.pushing.test1: unknown 9views; there are: 3views_gt"
    ):
        replace(CFG, test_settings={"pushing": {"test1": ("9views",)}})


def test_test_views_are_nested_and_every_object_has_a_row() -> None:
    world = BoxWorld(1)
    observations, detections, predictions = make_perceiver(world, is_train=False).perceive(0)
    views = {observation.setting: observation.views for observation in observations}
    assert set(views) == set(TEST_SETTINGS)
    assert views["1view_gt"] == views["1view_pred"] == views["5views_pred"][:1]
    assert views["3views_gt"] == views["5views_pred"][:3]
    exact = next(x for x in observations if x.setting == "3views_gt").objects.center_N3
    np.testing.assert_allclose(exact, world.episodes[0].steps[0].center_N3, atol=1e-6)
    for num_views in (1, 3):
        rows = [row for row in detections if row["num_views"] == num_views]
        assert sum(row["true_x_m"] is not None for row in rows) == len(world.episodes[0].bodies)
    assert [row["num_views"] for row in predictions] == [3, 1]
    assert all(row["camera"] not in views["5views_pred"] for row in predictions)


def test_finished_shards_are_not_perceived_again(tmp_path: Path) -> None:
    whole = perceive_split(make_perceiver(BoxWorld(3), is_train=True), tmp_path)[0]
    assert len(whole["episode_U"]) == 3 * 4 and set(whole["episode_U"].tolist()) == {0, 1, 2}
    (tmp_path / "shard_000002.safetensors").unlink()
    stamp = (tmp_path / "shard_000000.safetensors").stat().st_mtime_ns
    again = perceive_split(make_perceiver(BoxWorld(3), is_train=True), tmp_path)[0]
    assert (tmp_path / "shard_000000.safetensors").stat().st_mtime_ns == stamp
    for name, value in whole.items():
        torch.testing.assert_close(again[name], value, msg=name)
