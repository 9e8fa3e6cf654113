"""The model contact: samples, calibration of its uncertainty, and inputs of its encoder."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from oes.dynamics.augment import DynamicsBatch
from oes.dynamics.contact import Contact
from oes.dynamics.encoders.surface_encoder import SurfaceEncoder
from oes.dynamics.error_model import MIN_SIGMA_M, errors_and_spreads, fit_error_model
from oes.dynamics.shapes import ShapeUncertainty, shapes_of, unpack_shapes
from oes.dynamics.unroll import initial_state, teacher_forced, unroll, unroll_samples
from oes.metrics.errors import error_nll, error_quantile
from oes.mpc.search import Candidates
from oes.objects import LAYERS, SUPPORT, map_tensors
from oes.trials.world_models import GraphWorldModel, StateEstimate
from tests.test_dynamics_models import INPUTS, NET, make_actions, make_model, make_objects

UNCERTAINTY = ShapeUncertainty(
    num_samples=400,
    radius_sigma=1.0,
    harmonics=3,
    com_sigma_m=0.002,
    log_mass_sigma=0.1,
    log_friction_sigma=0.2,
)


def test_packing_is_lossless_and_unlikely_surfaces_are_dropped() -> None:
    objects = make_objects()
    objects.radial_profile_NRD3[0, 0, 3, :, 2] = 0.05
    shapes = shapes_of(objects)
    again = unpack_shapes(shapes.pack(), INPUTS.profile_rows, INPUTS.profile_directions)
    for name, value in vars(shapes).items():
        assert torch.equal(getattr(again, name), value), name
    assert (shapes.radius_BNRD[0, 0, 3] == 0).all() and (shapes.radius_BNRD[0, 1] > 0).all()


def test_objects_stand_on_their_support_or_else_on_their_lowest_layer() -> None:
    objects = make_objects(scenes=1, num=2)
    (
        objects.radial_profile_NRD3[:, :, SUPPORT, :, 0],
        objects.radial_profile_NRD3[:, :, LAYERS, :, 0],
    ) = 0.02, 0.03
    objects.radial_profile_NRD3[:, 1, SUPPORT, :, 2] = 0.05
    bodies = shapes_of(objects).bodies(objects.valid_N, 0.02)
    distance_BNP = (bodies.support_BNP2 + bodies.com_offset_BN2[:, :, None]).norm(dim=-1)
    torch.testing.assert_close(
        distance_BNP, torch.tensor([0.02, 0.03])[None, :, None].expand(distance_BNP.shape)
    )


def test_the_first_sample_is_the_input_and_the_spread_of_all_is_as_configured() -> None:
    shapes = shapes_of(make_objects())
    samples = shapes.sample(UNCERTAINTY, torch.Generator().manual_seed(0))
    first = {name: value[: len(shapes.mass_factor_BN)] for name, value in vars(samples).items()}
    for name, value in vars(shapes).items():
        torch.testing.assert_close(first[name], value)
    deviation = samples.radius_BNRD.unflatten(0, (UNCERTAINTY.num_samples, -1)) - shapes.radius_BNRD
    assert float(deviation.std(0).mean()) == pytest.approx(0.002 * 2**0.5, rel=0.1), (
        "standard deviation of a Laplace distribution"
    )
    assert float(samples.mass_factor_BN.log().std()) == pytest.approx(0.1, rel=0.1)
    assert float(samples.friction_factor_BN.log().std()) == pytest.approx(0.2, rel=0.1)
    torch.testing.assert_close(
        deviation[:, 0, 0], deviation[:, 1, 2], msg="all objects deviate alike"
    )


@torch.no_grad()
def test_a_forecast_is_the_mean_of_its_samples_with_their_spread() -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    objects = replace(
        objects, center_N3=objects.center_N3 * torch.tensor([1.0, 1.0, 0.0]) + tip[:, None] * 0.5
    )
    model = make_model("contact", objects)
    assert (
        isinstance(model, Contact) and model.num_samples == NET.contact.uncertainty.num_samples == 3
    )
    found = unroll(model, objects, tip, actions)
    samples = [
        unroll_samples(
            model, part, initial_state(objects.center_N3, objects.valid_N), tip, actions
        ).translation_BTN3
        for part in model.sample(model.appearance(objects)).chunk(3)
    ]
    torch.testing.assert_close(
        found.translation_BTN3, torch.stack(samples).mean(0), atol=1e-5, rtol=1e-4
    )
    assert (
        found.spread_BTN is not None
        and found.sigma_BTN is None
        and float(found.spread_BTN.max()) > 1e-4
    )
    model.error_model = fit_error_model(np.full((5, 50), 0.01), np.full((5, 50), 0.01))
    assert unroll(model, objects, tip, actions).sigma_BTN is not None
    assert model.train().num_samples == 1, "training uses the perceived shapes"


@torch.no_grad()
def test_objects_without_contact_stay_whatever_the_graph_network_outputs() -> None:
    objects = make_objects(scenes=1)
    objects = replace(
        objects, center_N3=torch.tensor([[[0.06, 0.0, 0.04], [0.0, 0.3, 0.04], [0.0, -0.3, 0.04]]])
    )
    model = make_model("contact", objects)
    assert isinstance(model, Contact)
    torch.nn.init.normal_(model.graph.head.weight, std=0.1)
    tip, actions = torch.zeros(1, 3), torch.tensor([[[0.05, 0.0, 0.0]] * 2])
    found = unroll(model, objects, tip, actions).translation_BTN3[0]
    torch.nn.init.zeros_(model.graph.head.weight)
    slid = unroll(model, objects, tip, actions).translation_BTN3[0]
    assert (found[:, 1:].abs() < 1e-5).all()
    assert float(slid[-1, 0].norm()) > 0.03
    assert float((found - slid)[-1, 0].norm()) > 1e-3, "sliding objects are corrected"


@pytest.mark.parametrize("wanted, used", [(1, 1), (2, 2), (100, 3)])
def test_a_plan_is_predicted_with_as_many_samples_as_wanted_and_available(
    wanted: int, used: int
) -> None:
    objects = make_objects(scenes=1)
    scene = map_tensors(objects, lambda x: x[0])
    estimate = StateEstimate(
        scene,
        scene.center_N3.double().numpy(),
        scene.size_N3.double().numpy(),
        np.ones(3, bool),
        None,
    )
    candidates = Candidates(
        torch.zeros(10, 3), torch.tensor([0.03, 0.0, 0.0]).expand(10, 2, 3), torch.zeros(10, 1)
    )
    model = GraphWorldModel(make_model("contact", objects))
    found, once = (
        model.predict(estimate, np.zeros((1, 3)), candidates, count) for count in (wanted, 1)
    )
    assert model.is_stochastic and found.num_samples == used
    assert found.position_STN3.shape == (used * 10, 2, 3, 3)
    torch.testing.assert_close(
        found.position_STN3[:10], once.position_STN3, msg="the first sample is the perceived scene"
    )


@torch.no_grad()
def test_teacher_forced_steps_start_at_the_true_states() -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    model = make_model("contact", objects).train()
    whole = unroll(model, objects, tip, actions)
    batch = DynamicsBatch(objects, tip, actions, whole.translation_BTN3, whole.rotation_BTN33)
    steps = teacher_forced(model, batch)
    torch.testing.assert_close(
        steps.translation_BTN3[:, 0], whole.translation_BTN3[:, 0], atol=1e-5, rtol=1e-4
    )
    far = torch.full_like(whole.translation_BTN3, 5.0)
    apart = teacher_forced(model, replace(batch, translation_BTN3=far))
    assert (apart.translation_BTN3[:, 1:] - 5).abs().max() < 0.5, (
        "motion continues from the given state"
    )


def test_calibration_recovers_the_distribution_of_simulated_errors() -> None:
    rng = np.random.default_rng(0)
    spread_TP = rng.gamma(2.0, 0.005, (3, 4000))
    scale_TP = np.hypot(np.array([[0.001], [0.002], [0.004]]), 1.5 * spread_TP)
    level_TP = rng.uniform(0, 1, scale_TP.shape)
    error_TP = scale_TP * np.sqrt(4.0 * ((1 - level_TP) ** (-2 / 4.0) - 1))
    found = fit_error_model(error_TP, spread_TP)
    assert found.floor_T == pytest.approx((0.001, 0.002, 0.004), rel=0.15)
    assert found.spread_gain == pytest.approx(1.5, rel=0.05) and found.dof == pytest.approx(
        4.0, rel=0.15
    )
    scale = found.sigma(torch.from_numpy(spread_TP)[None]).numpy()[0]
    for level in (0.5, 0.9):
        assert (error_TP < error_quantile(level, scale, found.dof)).mean() == pytest.approx(
            level, abs=0.01
        )
    same = np.broadcast_to(np.array(found.homoscedastic_sigma_T)[:, None], scale.shape)
    assert (
        error_nll(error_TP, scale, found.dof).mean()
        < error_nll(error_TP, same, found.homoscedastic_dof).mean()
    )
    more = found.sigma(torch.zeros(1, 5, 1))
    assert more[0, 3:, 0].tolist() == [pytest.approx(found.floor_T[-1])] * 2, (
        "later steps use the last floor"
    )


def test_resting_objects_do_not_make_forecasts_of_moving_ones_overconfident() -> None:
    rng = np.random.default_rng(0)
    spread_TP = rng.gamma(2.0, 0.005, (3, 400)) * (np.arange(400) % 4 > 0)
    error_TP = np.linalg.norm(rng.normal(size=(3, 400, 2)), axis=-1) * np.maximum(spread_TP, 1e-5)
    found = fit_error_model(error_TP, spread_TP)
    assert found.floor_T == pytest.approx([MIN_SIGMA_M] * 3)
    moved = spread_TP > 0
    scale_TP = found.sigma(torch.from_numpy(spread_TP)[None]).numpy()[0]
    assert 0.85 < (error_TP < error_quantile(0.9, scale_TP, found.dof))[moved].mean() < 0.95


def test_errors_and_spreads_are_of_valid_objects_only() -> None:
    true = torch.zeros(2, 3, 2, 3)
    predicted = true + torch.tensor([0.03, 0.04, 0.0])
    error_TP, spread_TP = errors_and_spreads(
        predicted, true, torch.ones(2, 3, 2), torch.tensor([[True, False], [True, True]])
    )
    assert error_TP.shape == spread_TP.shape == (3, 3) and error_TP == pytest.approx(0.05)


def test_edge_inputs_hold_the_clearance_above_and_below_another_object() -> None:
    """Two discs 50 mm high (layers of 20 mm, the third half full), one 30 mm above the other and
    aside by 20 mm.
    """
    objects = make_objects(scenes=1, num=2)
    outline = torch.zeros(1, 2, INPUTS.profile_rows, INPUTS.profile_directions, 3)
    outline[:, :, :6] = torch.tensor([0.03, 0.001, 1.0])
    size = torch.tensor([0.06, 0.06, 0.05]).expand(1, 2, 3)
    center = torch.tensor([[[0.0, 0.0, 0.025], [0.02, 0.0, 0.105]]])
    objects = replace(objects, center_N3=center, size_N3=size, radial_profile_NRD3=outline)
    encoder = SurfaceEncoder(replace(NET.contact.surface_points, rows=(3, 4, 5)), NET.graph.unit_m)
    state, shapes = initial_state(center, objects.valid_N), shapes_of(objects)
    first_BNP3, _, _, presence_BNP = encoder.points(shapes, state, torch.eye(3)[None])
    assert (presence_BNP == 1).all()
    points_BNP3 = first_BNP3 + center[:, :, None]
    assert points_BNP3[0, :, :, 2].unique().tolist() == pytest.approx(
        [0.01, 0.03, 0.05, 0.09, 0.11, 0.13]
    )
    numbers = encoder.edge_inputs(shapes, state, points_BNP3, torch.eye(3)[None]) * NET.graph.unit_m
    above_P, below_P = numbers[0, 1, 0, :, 5], numbers[0, 0, 1, :, 6]
    near_P = points_BNP3[0, 1, :, 0].hypot(points_BNP3[0, 1, :, 1]) < 0.0299
    assert above_P[near_P].unique().tolist() == pytest.approx([0.03, 0.05, 0.07]), (
        "of each layer's bottom"
    )
    assert above_P[~near_P].min() == pytest.approx(0.2), "nothing is below these"
    assert float(below_P.min()) == pytest.approx(0.03), (
        "the lower disc's top to the upper one's bottom"
    )
    assert numbers[0, 0, 0, :, 4].amin() == pytest.approx(0.01), (
        "a point of the lowest band above its own foot"
    )
