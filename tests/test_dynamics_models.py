"""Properties of all models: equivariance, padding, unrolling, learning one episode."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from oes.dynamics import MODELS
from oes.dynamics.augment import DynamicsBatch, rotate_flip, transform_batch
from oes.dynamics.encoders.crop_encoder import CropConfig, CropEncoder, fold
from oes.dynamics.encoders.surface_encoder import ContactConfig, SurfacePoints
from oes.dynamics.graph import GraphConfig, TipMotion
from oes.dynamics.loss import errors, loss_terms
from oes.dynamics.models import OES, GraphModel, GraphXYZ, ImageEncoderConfig, InputSpec, NetConfig
from oes.dynamics.reference_models import Static
from oes.dynamics.rigid_body.bodies import ContactPhysics
from oes.dynamics.shapes import ShapeUncertainty
from oes.dynamics.unroll import (
    DynamicsModel,
    advance_state,
    initial_state,
    unroll,
    unroll_mean,
    unroll_samples,
)
from oes.objects import Objects, map_tensors

NET = NetConfig(
    graph=GraphConfig(width=16, layers=3, rounds=2, unit_m=0.05, angular_velocity=True),
    crop=CropConfig(
        encoder="slabs",
        num_channels=2,
        num_slabs=2,
        channels=(4, 8, 8),
        width=16,
        cell_m=0.01,
        path_cell_m=0.0075,
    ),
    image=ImageEncoderConfig(channels=(4, 8), width=16),
    contact=ContactConfig(
        surface_points=SurfacePoints(
            direction_stride=4, rows=(0, 1), layer_height_m=0.02, width=8, mlp_layers=2
        ),
        physics=ContactPhysics(
            step_s=0.2,
            substeps=4,
            table_friction=0.4,
            rod_friction=0.24,
            object_friction=0.16,
            spinning_friction_m=0.001,
            contact_margin_m=0.002,
            rod_radius_m=0.008,
            tip_height_m=0.018,
            solver_iterations=2,
        ),
        uncertainty=ShapeUncertainty(
            num_samples=3,
            radius_sigma=1.0,
            harmonics=2,
            com_sigma_m=0.002,
            log_mass_sigma=0.1,
            log_friction_sigma=0.1,
        ),
        step_s=0.2,
        gt_surfaces=False,
    ),
)
OES_FALLING, CONTACT_FALLING = (
    "oes falling",
    "contact falling",
)  # the same models, reading what falls ask for
LEARNED = [
    *(name for name, kind in MODELS.items() if issubclass(kind, GraphModel)),
    OES_FALLING,
    CONTACT_FALLING,
]
FORECASTERS = [
    *(name for name, kind in MODELS.items() if issubclass(kind, DynamicsModel)),
    OES_FALLING,
    CONTACT_FALLING,
]
INPUTS = InputSpec(
    crop_channels=2,
    crop_side=16,
    voxel_m=0.01,
    image_side_px=32,
    profile_rows=7,
    profile_directions=32,
)
VIEWS = 2
ZERO = torch.zeros(3, 3, 3)


def make_objects(scenes: int = 3, num: int = 3, seed: int = 0) -> Objects:
    g = torch.Generator().manual_seed(seed)
    return Objects(
        center_N3=(torch.rand(scenes, num, 3, generator=g) - 0.5) * 0.2,
        size_N3=torch.full((scenes, num, 3), 0.08),
        score_N=torch.ones(scenes, num),
        valid_N=torch.ones(scenes, num, dtype=torch.bool),
        crop_NCXYZ=torch.rand(scenes, num, 2, 16, 16, 16, generator=g),
        image_NV3HW=torch.randint(
            256, (scenes, num, VIEWS, 3, 32, 32), generator=g, dtype=torch.uint8
        ),
        camera_NV12=torch.randn(scenes, num, VIEWS, 12, generator=g),
        view_NV=torch.tensor([True, False]).expand(scenes, num, VIEWS).clone(),
        radial_profile_NRD3=make_profiles(scenes, num, g),
        com_offset_N3=torch.randn(scenes, num, 3, generator=g) * 0.002,
    )


def make_profiles(scenes: int, num: int, g: torch.Generator) -> Tensor:
    """Ellipses 3 to 4 cm in radius at every height."""
    angle_D = torch.arange(32) * (2 * torch.pi / 32)
    waist = torch.rand(scenes, num, 1, 1, generator=g) * 0.01
    radius = 0.03 + waist * (angle_D + torch.rand(scenes, num, 1, 1, generator=g)).cos().square()
    radius = radius.expand(-1, -1, INPUTS.profile_rows, -1)
    return torch.stack([radius, torch.full_like(radius, 0.002), torch.ones_like(radius)], -1)


def make_actions(scenes: int = 3, steps: int = 5) -> tuple[Tensor, Tensor]:
    g = torch.Generator().manual_seed(7)
    actions = torch.randn(scenes, steps, 3, generator=g) * 0.04
    actions[..., 2] = 0
    return torch.randn(scenes, 3, generator=g) * 0.1, actions


def make_model(name: str, objects: Objects) -> DynamicsModel:
    torch.manual_seed(1)
    kind = MODELS[name.removesuffix(" falling")]
    falling = replace(
        NET.contact, surface_points=replace(NET.contact.surface_points, rows=(3, 4)), physics=None
    )
    is_falling = name in (OES_FALLING, CONTACT_FALLING)
    net = (
        replace(NET, crop=replace(NET.crop, encoder="heightmap"), contact=falling)
        if is_falling
        else NET
    )
    model = kind(net, INPUTS) if issubclass(kind, GraphModel) else kind()
    assert isinstance(model, DynamicsModel)
    return model.eval()


def only(objects: Objects, index: Tensor) -> Objects:
    return map_tensors(objects, lambda x: x[:, index])


@torch.no_grad()
@pytest.mark.parametrize("name", FORECASTERS)
def test_permuting_objects_permutes_the_forecast(name: str) -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    model, order = make_model(name, objects), torch.tensor([2, 0, 1])
    found, permuted = (
        unroll(model, objects, tip, actions),
        unroll(model, only(objects, order), tip, actions),
    )
    torch.testing.assert_close(permuted.translation_BTN3, found.translation_BTN3[:, :, order])
    torch.testing.assert_close(permuted.rotation_BTN33, found.rotation_BTN33[:, :, order])


@torch.no_grad()
@pytest.mark.parametrize(
    "name", [name for name in LEARNED if not name.startswith("contact")]
)  # it learns mirror images instead
def test_a_mirrored_scene_gets_the_mirrored_forecast(name: str) -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    model = make_model(name, objects)
    here = unroll(model, objects, tip, actions)
    R = rotate_flip(torch.tensor([0.0, torch.pi, torch.pi / 2]), torch.ones(3, dtype=torch.bool))
    there = transform_batch(
        DynamicsBatch(objects, tip, actions, here.translation_BTN3, here.rotation_BTN33),
        R,
        ZERO,
        0.01,
    )
    found = unroll(model, there.objects, there.tip_B3, there.actions_BT3)
    same = (
        slice(0, 1) if name.startswith("graph_xyz_image") else slice(None)
    )  # it sees the cameras' world axes
    torch.testing.assert_close(
        found.translation_BTN3[same], there.translation_BTN3[same], atol=1e-5, rtol=1e-3
    )
    torch.testing.assert_close(
        found.rotation_BTN33[same], there.rotation_BTN33[same], atol=1e-4, rtol=1e-3
    )


@torch.no_grad()
@pytest.mark.parametrize("name", FORECASTERS)
def test_the_forecast_does_not_depend_on_where_the_table_is(name: str) -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    model, along = make_model(name, objects), torch.tensor([0.3, -0.2, 0.0])
    found = unroll(model, objects, tip, actions)
    there = unroll(
        model, replace(objects, center_N3=objects.center_N3 + along), tip + along, actions
    )
    torch.testing.assert_close(there.translation_BTN3, found.translation_BTN3, atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(there.rotation_BTN33, found.rotation_BTN33, atol=1e-5, rtol=1e-4)


@torch.no_grad()
@pytest.mark.parametrize("name", LEARNED)
def test_padded_objects_change_nothing(name: str) -> None:
    objects, (tip, actions) = make_objects(num=2), make_actions()
    model, padded = make_model(name, objects), make_objects(num=3, seed=5)
    padded = map_tensors(objects, lambda x, y: torch.cat([x, y[:, 2:]], 1), padded)
    padded.valid_N[:, 2] = False
    found, wider = unroll(model, objects, tip, actions), unroll(model, padded, tip, actions)
    torch.testing.assert_close(wider.translation_BTN3[:, :, :2], found.translation_BTN3)
    assert not torch.equal(found.translation_BTN3, torch.zeros_like(found.translation_BTN3))


@torch.no_grad()
@pytest.mark.parametrize("name", FORECASTERS)
def test_a_scene_without_objects_has_an_empty_forecast(name: str) -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    found = unroll(
        make_model(name, objects), only(objects, torch.tensor([], dtype=torch.long)), tip, actions
    )
    assert found.translation_BTN3.shape == (3, 5, 0, 3) and found.rotation_BTN33.shape == (
        3,
        5,
        0,
        3,
        3,
    )


@torch.no_grad()
@pytest.mark.parametrize("name", FORECASTERS)
def test_unrolling_is_repeated_stepping(name: str) -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    model = make_model(name, objects)
    appearance, state = model.appearance(objects), initial_state(objects.center_N3, objects.valid_N)
    found = unroll_samples(model, appearance, state, tip, actions)
    for t, action in enumerate(actions.unbind(1)):
        state = advance_state(
            state, model(appearance, state, TipMotion(tip + actions[:, :t].sum(1), action))
        )
        torch.testing.assert_close(found.translation_BTN3[:, t], state.displacement_BN3)
        torch.testing.assert_close(found.rotation_BTN33[:, t], state.rotation_BN33)
    torch.testing.assert_close(state.center_BN3, objects.center_N3 + found.translation_BTN3[:, -1])


@torch.no_grad()
@pytest.mark.parametrize("name", LEARNED)
def test_rotations_stay_rotations(name: str) -> None:
    objects, (tip, actions) = make_objects(), make_actions(steps=10)
    R = unroll(make_model(name, objects), objects, tip, actions).rotation_BTN33
    torch.testing.assert_close(
        R @ R.transpose(-1, -2), torch.eye(3).expand_as(R), atol=1e-5, rtol=0
    )


@torch.no_grad()
@pytest.mark.parametrize("name", FORECASTERS)
def test_scenes_without_a_robot_are_forecast(name: str) -> None:
    objects, model = make_objects(), make_model(name, make_objects())
    found = unroll(model, objects, torch.full((3, 3), torch.nan), torch.zeros(3, 5, 3))
    assert found.translation_BTN3.isfinite().all() and found.rotation_BTN33.isfinite().all()


@torch.no_grad()
def test_missing_views_are_ignored() -> None:
    objects = make_objects()
    model = make_model("graph_xyz_image", objects)
    other = objects.image_NV3HW.clone()
    other[:, :, 1] = 0
    torch.testing.assert_close(
        model.appearance(replace(objects, image_NV3HW=other)), model.appearance(objects)
    )
    other[:, :, 0] = 0
    assert not torch.allclose(
        model.appearance(replace(objects, image_NV3HW=other)), model.appearance(objects)
    )


@torch.no_grad()
def test_forecasts_are_equivariant_to_rotating_the_state() -> None:
    """Rotating state and action rotates the motion; the appearance stays as it is at t = 0."""
    objects, (tip, actions) = make_objects(), make_actions()
    model = make_model("oes", objects)
    appearance, state = model.appearance(objects), initial_state(objects.center_N3, objects.valid_N)
    R = rotate_flip(torch.full((3,), 0.7), torch.zeros(3, dtype=torch.bool))
    here = unroll_mean(model, appearance, state, tip, actions)
    rotated_state = replace(
        state, center_BN3=state.center_BN3 @ R.mT, rotation_BN33=R[:, None] @ state.rotation_BN33
    )
    there = unroll_mean(
        model, appearance, rotated_state, (R @ tip[..., None])[..., 0], actions @ R.mT
    )
    torch.testing.assert_close(
        there.translation_BTN3, here.translation_BTN3 @ R[:, None].mT, atol=1e-6, rtol=1e-4
    )


def test_the_rotation_loss_is_half_the_angle_for_small_angles() -> None:
    objects, (tip, actions) = make_objects(), make_actions()
    rest = unroll(Static(), objects, tip, actions)
    R = rotate_flip(torch.full((3,), 0.1), torch.zeros(3, dtype=torch.bool))[:, None, None].expand(
        3, 5, 3, 3, 3
    )
    truth = DynamicsBatch(objects, tip, actions, rest.translation_BTN3 + 0.05 / 3**0.5, R)
    terms = loss_terms(rest, truth, 0.05, 1e-4)
    assert float(terms["rotation"]) == pytest.approx(0.05, rel=0.01)
    assert float(terms["translation"]) == pytest.approx(1.0, rel=1e-3)
    watched = errors(rest, truth)
    assert watched["mm_5"] == pytest.approx(50, rel=1e-4)
    assert watched["deg_1"] == pytest.approx(5.7296, rel=1e-3)


@pytest.mark.parametrize("name", LEARNED)
def test_every_model_overfits_one_episode(name: str) -> None:
    objects, tip, actions = (
        make_objects(scenes=1, num=1),
        torch.zeros(1, 3),
        torch.tensor([[[0.05, 0.0, 0.0]] * 5]),
    )
    objects = replace(
        objects, center_N3=torch.tensor([[[0.05, 0.0, 0.04]]])
    )  # before the rod, or nothing slides
    model = make_model(name, objects).train()
    R = rotate_flip(torch.linspace(0.1, 0.5, 5), torch.zeros(5, dtype=torch.bool))[
        None, :, None, :, :
    ]
    truth = DynamicsBatch(
        objects,
        tip,
        actions,
        actions.cumsum(1)[:, :, None] * torch.tensor([0.8, 1.0, 1.0]) + 0.01,
        R,
    )
    adam = torch.optim.Adam(model.parameters(), lr=5e-3)
    losses = []
    for _ in range(60):
        terms = loss_terms(unroll(model, objects, tip, actions), truth, 0.05, 1e-4)
        losses.append(float(sum(terms.values()).detach()))  # type: ignore[union-attr]
        adam.zero_grad()
        sum(terms.values()).backward()  # type: ignore[union-attr]
        adam.step()
    assert losses[-1] < 0.25 * losses[0]


def test_models_share_one_graph_network() -> None:
    """The baselines differ from ours in their inputs only (appendix C.2)."""
    ours, theirs = (kind(NET, INPUTS).graph for kind in (OES, GraphXYZ))
    assert [type(m) for m in ours.modules()] == [type(m) for m in theirs.modules()]


def test_slabs_are_means_over_height() -> None:
    crop = torch.rand(1, 1, 2, 4, 4, 4)
    folded = fold(crop, 2)
    assert folded.shape == (1, 1, 4, 4, 4)
    torch.testing.assert_close(folded[0, 0, 3], crop[0, 0, 1, ..., 2:].mean(-1))


def test_windows_show_objects_in_their_current_pose() -> None:
    """A block ahead of an object's centre at first; then the object is rotated by 90 degrees, and
    the tip passes it.
    """
    encoder = CropEncoder(NET.crop, 2, 16, 0.16)
    slabs = torch.zeros(1, 2, 2, 16, 16)
    slabs[0, 0, :, 8:12, 7:9] = 1
    R = rotate_flip(torch.tensor([torch.pi / 2]), torch.tensor([False]))
    state = initial_state(
        torch.tensor([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]]), torch.ones(1, 2, dtype=torch.bool)
    )
    state = replace(state, rotation_BN33=R[:, None].expand(1, 2, 3, 3))
    shapes = (slabs, state.center_BN3, torch.full((1, 2), torch.pi / 2))
    world_P3 = torch.tensor(
        [[0.0, 0.02, 0.0], [0.02, 0.0, 0.0], [0.0, -0.02, 0.0], [0.0, 0.035, 0.0]]
    )
    seen = encoder.sample(shapes, world_P3.repeat(64, 1).expand(1, 2, 256, 3))[0, 0, 0].flatten()[
        :4
    ]
    torch.testing.assert_close(seen, torch.tensor([1.0, 0.0, 0.0, 1.0]), atol=1e-4, rtol=0)
    tip = TipMotion(torch.tensor([[-0.05, 0.0, 0.0]]), torch.tensor([[0.05, 0.0, 0.0]]))
    full = encoder(slabs, state, tip)
    bare = encoder(torch.zeros_like(slabs), state, tip)
    assert not torch.equal(full.agent_BNC[:, 0], bare.agent_BNC[:, 0])
    torch.testing.assert_close(full.node_BNC[:, 1], bare.node_BNC[:, 1])
    assert not torch.equal(full.edge_BNNC[0, 1, 0], bare.edge_BNNC[0, 1, 0])
