"""The video-prediction baselines: camera, clips, and training on a moving square."""

from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from oes.baselines.clips import Clips, ClipsError, read_clips, sample_clips, write_clips
from oes.baselines.evaluate import forecast_rows
from oes.baselines.losses import PlanetLossConfig, draw_goals
from oes.baselines.overhead_camera import OverheadCamera, OverheadView
from oes.baselines.overhead_render import OverheadConfig, make_clips
from oes.baselines.planet import PlaNet, PlanetConfig, distance_to_goals
from oes.baselines.train import (
    BaselineError,
    BaselinesConfig,
    ForesightTraining,
    PlanetTraining,
    is_baseline,
    load_baseline,
    save_baseline,
    train_baseline,
)
from oes.baselines.visual_foresight import (
    FlowWarp,
    ForesightConfig,
    VisualForesight,
    expected_pixel,
    pixel_distribution,
    unroll_pixels,
)
from oes.config import load
from oes.sim.simulate import EpisodesConfig, simulate
from oes.training.checkpoint import TrainConfig
from tests.blocks import SMOKE, make_catalogue

VIEW = OverheadView(side_px=64, height_m=1.5, half_m=0.32)
FIT = TrainConfig(
    steps=60,
    batch=8,
    optimizer="adamw",
    lr=3e-3,
    warmup_steps=5,
    weight_decay=0.0,
    clip=1.0,
    ema_decay=0.0,
    bfloat16=False,
    checkpoint_every_steps=60,
    log_every_steps=20,
    seed=0,
)
CFG = BaselinesConfig(
    visual_foresight=ForesightTraining(
        net=ForesightConfig(channels=(8, 16, 16), num_flows=2), changed_pixel_weight=10.0, fit=FIT
    ),
    planet=PlanetTraining(
        net=PlanetConfig(
            base_channels=4, recurrent_dim=32, stochastic_dim=8, hidden_dim=32, max_goals=2
        ),
        loss=PlanetLossConfig(free_nats=1.0, changed_pixel_weight=20.0, goal_range=0.5),
        weights={"image": 1000.0, "reward": 100.0, "kl": 1.0},
        fit=FIT,
    ),
)


def _squares(count: int, seed: int) -> Clips:
    """A red square of 10 pixels on grey that moves with the rod at its centre."""
    rng = np.random.default_rng(seed)
    start, push = rng.uniform(-0.4, 0.4, (count, 1, 2)), rng.uniform(-0.12, 0.12, (count, 5, 2))
    path = start + np.concatenate([np.zeros((count, 1, 2)), push.cumsum(1)], 1)
    position = torch.from_numpy(path).float()
    frame = torch.full((count, 6, 3, 64, 64), 128, dtype=torch.uint8)
    line = (torch.arange(64) + 0.5) / 32 - 1
    y, x = torch.meshgrid(line, line, indexing="ij")
    offset_x, offset_y = (c - position[..., i, None, None] for i, c in enumerate((x, y)))
    inside = (offset_x.abs() < 0.16) & (offset_y.abs() < 0.16)
    frame[:, :, 0][inside] = 250
    frame[:, :, 1:].permute(0, 1, 3, 4, 2)[inside] = 20
    return Clips(frame, position, position[:, :, None], torch.ones(count, 1, dtype=torch.bool))


def test_overhead_camera_unproject_inverts_project() -> None:
    camera = OverheadCamera(VIEW)
    world = np.array([[0.1, 0.2, 0.05], [-0.25, 0.0, 0.0]])
    ndc = camera.project(world)
    assert ndc[1] == pytest.approx([-0.25 / 0.32, 0.0], abs=1e-9)
    assert ndc[0, 0] > 0.1 / 0.32 and ndc[0, 1] < 0, (
        "higher points are nearer; +y is up in the image"
    )
    assert camera.unproject(ndc, world[:, 2]) == pytest.approx(world[:, :2])


def test_objects_appear_at_their_image_coordinates(tmp_path: Path) -> None:
    catalogue, cfg = make_catalogue(tmp_path / "meshes"), load(SMOKE, "episodes", EpisodesConfig)
    episode = simulate(catalogue, cfg, "pushing", "test2", 0)
    clips = make_clips([episode], catalogue, OverheadConfig(view=VIEW, sim=cfg.sim))
    assert clips.frame_BI3HW.shape == (1, len(episode.steps), 3, 64, 64) and clips.valid_BN.all()
    empty = clips.frame_BI3HW.float().amax((0, 1))
    for position in clips.object_BIN2[0, 0]:
        column, row = ((position + 1) * 32).long().tolist()
        around = clips.frame_BI3HW[0, 0, :, row - 1 : row + 2, column - 1 : column + 2].float()
        assert (around - empty[:, :1, :1]).abs().mean() > 5
    write_clips(clips, VIEW, tmp_path)
    again, view = read_clips(tmp_path)
    assert view == VIEW
    assert all(torch.equal(value, vars(again)[name]) for name, value in vars(clips).items())
    (tmp_path / "clips.safetensors").write_bytes(b"junk")
    with pytest.raises(ClipsError, match=r"clips.safetensors: not a readable"):
        read_clips(tmp_path)


def _red_centroid(frame_3HW: Tensor) -> Tensor:
    red = (frame_3HW[0] - frame_3HW[1]).clamp(min=0)
    line = (torch.arange(64) + 0.5) / 32 - 1
    return torch.stack([(red.sum(0) * line).sum(), (red.sum(1) * line).sum()]) / red.sum()


@pytest.mark.parametrize("quarter", range(4))
@pytest.mark.parametrize("is_mirrored", [False, True])
def test_rotated_clips_move_coordinates_with_images(quarter: int, is_mirrored: bool) -> None:
    clips = _squares(3, 0).at(torch.arange(3)).rotated(quarter, is_mirrored)
    for clip_i in range(3):
        assert _red_centroid(clips.frame_BI3HW[clip_i, 2]).tolist() == pytest.approx(
            clips.tip_BI2[clip_i, 2].tolist(), abs=0.02
        )
        assert torch.equal(clips.object_BIN2[clip_i, :, 0], clips.tip_BI2[clip_i])


def test_sampled_clips_depend_on_their_generator_alone() -> None:
    clips = _squares(5, 0)
    first, again, other = (
        sample_clips(clips, 4, np.random.default_rng(seed)) for seed in (0, 0, 1)
    )
    assert torch.equal(first.frame_BI3HW, again.frame_BI3HW)
    assert not torch.equal(first.frame_BI3HW, other.frame_BI3HW)
    assert first.frame_BI3HW.max() <= 1


def test_a_known_flow_warps_probability_maps() -> None:
    flow = torch.zeros(1, 1, 64, 64, 2)
    flow[..., 0] = -4 / 32  # content comes from 4 pixels to the left
    mask = torch.zeros(1, 3, 64, 64)
    mask[:, 0] = 1
    start = pixel_distribution(torch.tensor([[[0.1, -0.2]]]), 64, 64)
    assert expected_pixel(start)[0, 0].tolist() == pytest.approx([0.1, -0.2], abs=1e-3)
    assert start.sum() == pytest.approx(1)
    warped = FlowWarp(flow, mask)(start, start)
    assert expected_pixel(warped)[0, 0].tolist() == pytest.approx([0.1 + 4 / 32, -0.2], abs=1e-3)


def test_visual_foresight_learns_to_move_a_square(tmp_path: Path) -> None:
    net, _ = train_baseline(CFG, "visual_foresight", _squares(64, 0), tmp_path, torch.device("cpu"))
    assert isinstance(net, VisualForesight)
    rows, image = forecast_rows(net, _squares(8, 1), VIEW.half_m)
    last = [row for row in rows if row["T"] == 3]
    mean = {name: np.mean([row[name] for row in last]) for name in last[0]}
    assert mean["error_mm"] < 0.6 * mean["still_mm"]
    assert mean["psnr_db"] > mean["still_psnr_db"] + 1
    assert image.shape == (4 * 2 * 64, 6 * 64, 3)


def test_planet_learns_the_reward_of_a_square(tmp_path: Path) -> None:
    net, log = train_baseline(CFG, "planet", _squares(64, 0), tmp_path, torch.device("cpu"))
    assert isinstance(net, PlaNet)
    assert log[-1]["reward"] < 0.7 * log[0]["reward"] and log[-1]["image"] < log[0]["image"]
    rows, _ = forecast_rows(net, _squares(4, 1), VIEW.half_m)
    assert all(np.isfinite([row["error_mm"], row["psnr_db"]]).all() for row in rows)


def test_goals_are_ordered_like_objects_from_left_to_right() -> None:
    clips = _squares(2, 0).at(torch.arange(2))
    objects = torch.tensor([[[0.3, 0.0], [-0.3, 0.1]]]).expand(2, 6, 2, 2)
    clips = Clips(
        clips.frame_BI3HW, clips.tip_BI2, objects, torch.tensor([[True, True], [True, False]])
    )
    ordered, goals = draw_goals(clips, 2, 0.5)
    assert ordered[0, 0, :, 0].tolist() == pytest.approx([-0.3, 0.3])
    assert ordered[1, 0, 0, 0] == pytest.approx(0.3)
    assert goals[:, :, 2].tolist() == [[1, 1], [1, 0]]
    goals = torch.tensor([[[-0.3, 0.2, 1.0], [0.3, 0.3, 1.0]], [[0.3, 0.4, 1.0], [0, 0, 0]]])
    assert distance_to_goals(ordered[:, 0], goals).tolist() == pytest.approx([0.2, 0.4])


def test_saved_baselines_load_again(tmp_path: Path) -> None:
    for kind, cfg in ((VisualForesight, CFG.visual_foresight.net), (PlaNet, CFG.planet.net)):
        net = kind(cfg).eval()  # type: ignore[arg-type]
        save_baseline(tmp_path, net, VIEW)
        again, view = load_baseline(tmp_path)
        assert type(again) is kind and view == VIEW and is_baseline(tmp_path)
        assert all(
            torch.equal(a, b)
            for a, b in zip(net.state_dict().values(), again.state_dict().values(), strict=True)
        )
    (tmp_path / "model.safetensors").write_bytes(b"junk")
    assert not is_baseline(tmp_path)
    with pytest.raises(BaselineError, match="not a readable"):
        load_baseline(tmp_path)
    with pytest.raises(BaselineError, match=r"unknown model 'sora'.*planet"):
        train_baseline(CFG, "sora", _squares(2, 0), tmp_path, torch.device("cpu"))


def test_unrolled_pixel_maps_remain_distributions() -> None:
    torch.manual_seed(0)
    net = VisualForesight(CFG.visual_foresight.net).eval()
    frames, maps = unroll_pixels(
        net, torch.rand(3, 64, 64), torch.zeros(2, 2), torch.zeros(4, 2), torch.full((4, 3, 2), 0.1)
    )
    assert frames.shape == (4, 3, 3, 64, 64) and maps.shape == (4, 3, 2, 64, 64)
    assert maps.sum((-2, -1)).flatten().tolist() == pytest.approx([1.0] * 24, abs=1e-4)
    assert maps.min() >= 0
