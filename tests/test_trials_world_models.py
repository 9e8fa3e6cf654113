"""Image-based world models, on networks with known outputs."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from oes.baselines.overhead_camera import OverheadView
from oes.baselines.planet import PlaNet, PlanetConfig
from oes.baselines.visual_foresight import ForesightConfig, VisualForesight
from oes.mpc.search import Candidates
from oes.objects import Objects
from oes.trials.world_models import ForesightWorldModel, PlanetWorldModel, StateEstimate

VIEW = OverheadView(side_px=64, height_m=1.5, half_m=0.32)
CENTERS = np.array([[0.1, 0.05, 0.03], [-0.12, 0.0, 0.02]])
GOALS = CENTERS + np.array([[0.1, 0.0, 0.0], [0.0, -0.05, 0.0]])
PLANET = PlanetConfig(
    base_channels=4, recurrent_dim=16, stochastic_dim=4, hidden_dim=16, max_goals=2
)
TIPS = torch.tensor([[0.0, 0.05, 0.02], [0.0, 0.0, 0.02], [0.2, 0.2, 0.02]])
CANDIDATES = Candidates(
    TIPS, torch.full((3, 4, 3), 0.03) * torch.tensor([1.0, 1, 0]), torch.zeros(3, 0)
)


def _estimate() -> StateEstimate:
    count = len(CENTERS)
    center, size = torch.from_numpy(CENTERS).float(), torch.full((count, 3), 0.07)
    objects = Objects(
        center_N3=center,
        size_N3=size,
        score_N=torch.ones(count),
        valid_N=torch.ones(count, dtype=torch.bool),
        crop_NCXYZ=torch.zeros(count, 1, 16, 16, 16),
        image_NV3HW=torch.zeros(count, 1, 3, 32, 32, dtype=torch.uint8),
        camera_NV12=torch.zeros(count, 1, 12),
        view_NV=torch.ones(count, 1, dtype=torch.bool),
        radial_profile_NRD3=torch.zeros(count, 6, 32, 3),
        com_offset_N3=torch.zeros(count, 3),
    )
    image = np.random.default_rng(0).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    return StateEstimate(objects, CENTERS, size.numpy(), np.ones(count, dtype=bool), image)


def test_visual_foresight_without_flow_predicts_static_objects() -> None:
    net = VisualForesight(ForesightConfig(channels=(8, 8), num_flows=2)).eval()
    torch.nn.init.zeros_(net.out.weight)
    torch.nn.init.zeros_(net.out.bias)
    rollouts = ForesightWorldModel(net, VIEW).predict(_estimate(), GOALS, CANDIDATES)
    assert rollouts.tip_SI3.shape == (3, 5, 3)
    assert torch.allclose(rollouts.tip_SI3[:, -1, :2], TIPS[:, :2] + 0.12)
    assert np.abs(rollouts.position_STN3.numpy() - CENTERS).max() < 1e-3
    assert rollouts.cost_ST is not None and rollouts.cost_ST.shape == (3, 4)
    assert rollouts.cost_ST.flatten().tolist() == pytest.approx([0.075] * 12, rel=0.06), (
        "expected distance, mean"
    )


def test_visual_foresight_moves_objects_with_their_pixels() -> None:
    """Every pixel moves right by one (1 cm) per step."""
    net = VisualForesight(ForesightConfig(channels=(8, 8), num_flows=1)).eval()
    torch.nn.init.zeros_(net.out.weight)
    net.out.bias.data[:] = torch.tensor([float(np.arctanh(-2 / 64 / 0.3)), 0.0, 20.0, 0.0, 0.0])
    rollouts = ForesightWorldModel(net, VIEW).predict(_estimate(), GOALS, CANDIDATES)
    moved = rollouts.position_STN3[:, -1].numpy() - CENTERS
    assert moved[..., 0] == pytest.approx(0.04, abs=2e-3) and np.abs(moved[..., 1]).max() < 1e-3


def test_planet_cost_is_minus_reward_and_objects_are_static() -> None:
    torch.manual_seed(0)
    net = PlaNet(PLANET).eval()
    model = PlanetWorldModel(net, VIEW)
    rollouts = model.predict(_estimate(), GOALS, CANDIDATES)
    assert rollouts.cost_ST is not None and rollouts.cost_ST.shape == (3, 4)
    assert torch.isfinite(rollouts.cost_ST).all()
    assert torch.equal(rollouts.position_STN3[1, 2], torch.from_numpy(CENTERS).float())
    torch.nn.init.zeros_(net.reward_head[-1].weight)
    net.reward_head[-1].bias.data[:] = -0.5
    assert (model.predict(_estimate(), GOALS, CANDIDATES).cost_ST == 0.5 * VIEW.half_m).all()


def test_planet_orders_goals_from_left_to_right() -> None:
    """Swapping both the objects and their goals changes nothing."""
    torch.manual_seed(0)
    net = PlaNet(PLANET).eval()
    model, estimate = PlanetWorldModel(net, VIEW), _estimate()
    swapped = replace(estimate, center_N3=CENTERS[::-1].copy())
    first, again = (
        model.predict(b, g, CANDIDATES).cost_ST
        for b, g in ((estimate, GOALS), (swapped, GOALS[::-1].copy()))
    )
    other = model.predict(swapped, GOALS, CANDIDATES).cost_ST
    assert first is not None and again is not None and other is not None
    assert torch.equal(first, again) and not torch.allclose(first, other)
