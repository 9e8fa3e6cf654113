"""The perception network: batches, empty scenes, weight files and overfitting one scene."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from oes.config import to_json
from oes.episode import Frames
from oes.objects import map_tensors
from oes.perception.evaluate import detection_rows, detection_summary, gt_objects
from oes.perception.lift import views_of
from oes.perception.losses import LOSS_TERMS, losses
from oes.perception.network import PerceptionNet
from oes.perception.perceiver import PERCEPTION_FORMAT, Perceiver, PerceptionFileError
from oes.perception.samples import Sampler
from tests.perception_scenes import GRID, BoxWorld, box_solids, sampling, small_network

CPU = torch.device("cpu")


def make_perceiver() -> Perceiver:
    torch.manual_seed(0)
    return Perceiver(PerceptionNet(small_network()), CPU)


def test_scenes_of_a_batch_are_independent() -> None:
    world, net = BoxWorld(2), make_perceiver().net
    scenes = [views_of(*world.read(i, 0, [1, 4])) for i in range(2)]
    both = map_tensors(scenes[0], lambda *x: torch.cat(x), scenes[1])
    boxes = torch.tensor([[[0.0, 0.1, 0.03]], [[0.05, -0.1, 0.03]]]), torch.full((2, 1, 3), 0.1)
    with torch.no_grad():
        batched = net.encode(both)
        masks = net.regions(batched, boxes).mask_BNXYZ
        for i, views in enumerate(scenes):
            single = net.encode(views)
            torch.testing.assert_close(
                batched.coarse_BCXYZ[i : i + 1], single.coarse_BCXYZ, atol=1e-3, rtol=1e-3
            )
            mask = net.regions(single, (boxes[0][i : i + 1], boxes[1][i : i + 1])).mask_BNXYZ
            torch.testing.assert_close(masks[i : i + 1], mask, atol=1e-3, rtol=1e-3)


def test_an_empty_scene_has_no_objects() -> None:
    world, perceiver = BoxWorld(1), make_perceiver()
    frames, cameras = world.read(0, 0, [0, 1])
    empty = Frames(frames.rgb_VHW3 * 0, frames.depth_m_VHW * 0, frames.seg_VHW)
    torch.nn.init.constant_(perceiver.net.roi.box[-1].bias, -9.0)
    scene = perceiver.encode(empty, cameras)
    boxes = perceiver.detect(scene)
    assert [len(value) for value in boxes] == [0, 0, 0]
    objects = perceiver.objects(scene, boxes, empty, cameras)
    assert objects.crop_NCXYZ.shape == (0, 7, 16, 16, 16)
    assert objects.image_NV3HW.shape == (0, 2, 3, 32, 32)
    rows = detection_rows(perceiver, scene, gt_objects(world.episodes[0], 0, box_solids()))
    assert len(rows) == len(world.episodes[0].bodies) and all(row["score"] is None for row in rows)
    assert detection_summary([row | {"episode": 0} for row in rows])["ap_25"] == 0


def test_objects_contain_masked_features_and_image_crops() -> None:
    world, perceiver = BoxWorld(1), make_perceiver()
    step = world.episodes[0].steps[0]
    frames, cameras = world.read(0, 0, [0, 3])
    centers, sizes = torch.tensor(step.center_N3), torch.tensor(step.size_N3)
    boxes = centers, sizes, torch.ones(len(centers))
    objects = perceiver.objects(perceiver.encode(frames, cameras), boxes, frames, cameras)
    mask, behind, hidden = objects.crop_NCXYZ[:, :3].unbind(1)
    assert 0 <= mask.min() and mask.max() <= 1
    assert ((behind >= 0) & (behind <= 1)).all()
    assert hidden.max() > 0 and (behind[hidden > 0] > 0).all()
    color = np.random.default_rng(world.episodes[0].bodies[0].texture_seed).integers(60, 255, 3)
    np.testing.assert_allclose(objects.image_NV3HW[0, :, :, 16, 16], np.tile(color, (2, 1)), atol=1)
    np.testing.assert_allclose(
        objects.camera_NV12[0, 1].reshape(3, 4), cameras[1].world_T_cam_44[:3], atol=1e-6
    )


def test_loaded_weights_render_the_same_view(tmp_path: Path) -> None:
    world, perceiver = BoxWorld(1), make_perceiver()
    perceiver.save(tmp_path / "a.safetensors")
    again = Perceiver.load(tmp_path / "a.safetensors")
    frames, cameras = world.read(0, 0, [2])
    query = world.episodes[0].steps[0].cameras[5]
    image, repeated = (p.render(p.encode(frames, cameras), query) for p in (perceiver, again))
    assert image.shape == (64, 64, 3) and image.dtype == np.uint8
    np.testing.assert_array_equal(repeated, image)


def test_invalid_weight_files_are_rejected_with_their_name(tmp_path: Path) -> None:
    path = tmp_path / "weights.safetensors"
    with pytest.raises(PerceptionFileError, match=r"weights.safetensors: not a readable"):
        Perceiver.load(path)
    path.write_bytes(b"garbage")
    with pytest.raises(PerceptionFileError, match="not a readable"):
        Perceiver.load(path)
    save_file({"a": torch.zeros(1)}, path)
    with pytest.raises(PerceptionFileError, match="format is None"):
        Perceiver.load(path)
    perceiver = make_perceiver()
    perceiver.save(path)
    tensors, config = load_file(path), to_json(small_network())
    metadata = {"format": PERCEPTION_FORMAT}
    other_config = config.replace('"hidden":32', '"hidden":48')
    save_file(tensors, path, metadata | {"config": other_config})
    with pytest.raises(PerceptionFileError, match="do not fit the stored config"):
        Perceiver.load(path)
    save_file(tensors, path, metadata | {"config": config.replace("hidden", "width")})
    with pytest.raises(PerceptionFileError, match="hidden: missing"):
        Perceiver.load(path)


def test_batches_depend_on_the_step_only_and_query_no_input_view() -> None:
    sampler = Sampler(sampling(), 2, 1, 0, GRID, BoxWorld(4), box_solids(), range(4))
    first, again, later = sampler.batch_at(5), sampler.batch_at(5), sampler.batch_at(6)
    torch.testing.assert_close(first.views.depth_m_BVHW, again.views.depth_m_BVHW)
    torch.testing.assert_close(first.region_center_BN3, again.region_center_BN3)
    assert not torch.equal(first.query.rgb_BVHW3, later.query.rgb_BVHW3)
    inputs, query = first.views.world_T_cam_BV44, first.query.world_T_cam_BV44
    assert ((inputs - query).abs().flatten(2).amax(-1) > 1e-3).all()


def test_overfitting_one_scene_reduces_its_losses() -> None:
    torch.manual_seed(0)
    net, world = PerceptionNet(small_network()), BoxWorld(1, seed=2)
    sampler = Sampler(sampling(), 1, 0, 0, GRID, world, box_solids(), [0])
    batch = sampler.batch_at(0)
    optimizer = torch.optim.Adam(net.parameters(), 3e-3)
    history = []
    for _ in range(60):
        terms = losses(net, batch, num_proposals=1, num_rendered=1)
        history.append({name: value.item() for name, value in terms.items()})
        optimizer.zero_grad()
        torch.stack(list(terms.values())).sum().backward()
        optimizer.step()
    first, last = history[0], history[-1]
    assert sorted(first) == sorted(LOSS_TERMS)
    for name in ("objectness", "box", "occupancy", "mask", "view"):
        assert last[name] < 0.6 * first[name], (name, first[name], last[name])
