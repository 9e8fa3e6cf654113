"""Bullet bodies in their obj frames, the arm's kinematics and tracking, and the rig; all on the
real simulator.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from oes.config import ParamsError, from_json, load, to_json
from oes.episode import FIRST_OBJECT, ROBOT, TABLE, Body, Floats
from oes.geom.boxes import aabb
from oes.geom.camera import project
from oes.geom.se3 import inverse, rigid, rotation_z, transform
from oes.meshes.catalogue import Catalogue, save_catalogue, write_mesh
from oes.meshes.draft import Draft, StandConfig, placed
from oes.meshes.generators.mit_push import plate
from oes.meshes.generators.procedural import generate
from oes.sim.arm import ReachError, joints_for
from oes.sim.bodies import body_footprint, mass_frame, upright
from oes.sim.pushing import PushWorld
from oes.sim.rig import rig
from oes.sim.robot import robot_shape
from oes.sim.simulate import EpisodesConfig
from oes.sim.world import SimConfig, World, count_steps

SIM = load(Path("params.yaml"), "episodes", EpisodesConfig).sim
ORIGIN_TIP = np.array([0.0, 0.0, SIM.robot.tip_height_m])


def make_meshes(folder: Path) -> Catalogue:
    """A mug and a triangular plate to train on, a bowl and a square plate to test on."""
    rng = np.random.default_rng(0)
    shapes = {
        "mug": generate("mug", 0, rng),
        "tri": plate("tri1", 0.09, 0.04),
        "bowl": generate("bowl", 0, rng),
        "rect": plate("rect1", 0.08, 0.04),
    }
    for name, shape in shapes.items():
        draft = Draft(name, name, "test", "generated", shape.solid, shape.parts)
        write_mesh(
            *placed(draft, 0.08, StandConfig(max_aspect=6.0, max_tilt_deg=15.0)), folder / name
        )
    return save_catalogue(
        folder, {"mug": "train", "tri": "train", "bowl": "test", "rect": "test"}, []
    )


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    return make_meshes(tmp_path_factory.mktemp("meshes"))


@pytest.fixture(scope="module")
def world(catalogue: Catalogue) -> Iterator[World]:
    with World(catalogue, SIM) as opened:
        yield opened


def body_of(mesh: str, scale_3: tuple[float, float, float] = (0.9, 1.0, 1.15)) -> Body:
    return Body(mesh, mesh, np.array(scale_3), mass_kg=0.25, friction=0.4, texture_seed=0)


@pytest.mark.parametrize("mesh", ["mug", "tri", "bowl", "rect"])
def test_objects_rest_where_they_stand(mesh: str, catalogue: Catalogue, world: World) -> None:
    """Upright on the table, nothing moves but the collision margin (about 1 mm), and the table is
    what they touch.
    """
    pose = upright(catalogue.meshes[mesh], body_of(mesh), np.array([0.05, -0.03]), 0.7)
    world.reset([body_of(mesh)], pose[None], None)
    world.run(400)
    moved_m = world.poses()[0] - pose
    assert np.abs(moved_m[:2, 3]).max() < 1e-3
    assert 0 <= moved_m[2, 3] < 1.5e-3
    assert np.abs(moved_m[:3, :3]).max() < 0.01
    assert world.contacts()[TABLE, FIRST_OBJECT]


def test_the_frame_of_the_mass_is_that_of_the_scaled_volume(catalogue: Catalogue) -> None:
    mesh, scale_3 = catalogue.meshes["mug"], np.array([0.85, 1.0, 1.15])
    obj_T_com, moments = mass_frame(mesh, scale_3, 0.3)
    scaled = trimesh.Trimesh(mesh.visual.vertices * scale_3, mesh.visual.faces, process=False)
    axes = obj_T_com[:3, :3]
    assert obj_T_com[:3, 3] == pytest.approx(scaled.center_mass, abs=2e-4)
    about_com = axes @ np.diag(moments) @ axes.T * scaled.volume / 0.3
    assert about_com == pytest.approx(
        scaled.moment_inertia, rel=0.03, abs=0.02 * np.abs(scaled.moment_inertia).max()
    )
    assert np.linalg.det(axes) == pytest.approx(1)


def test_a_falling_mug_keeps_its_frame_while_its_mass_centre_falls(
    catalogue: Catalogue, world: World
) -> None:
    """Its centre of mass is off the box centre: what flies a parabola is that centre, and the obj
    frame goes along.
    """
    mesh, body = catalogue.meshes["mug"], body_of("mug")
    com_obj = mass_frame(mesh, body.scale_3, body.mass_kg)[0][:3, 3]
    assert np.linalg.norm(com_obj) > 2e-3
    start = rigid(
        rotation_z(0.4) @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0.0, 0.0, 0.5])
    )
    world.reset([body], start[None], None)
    assert world.poses()[0] == pytest.approx(start, abs=0)
    world.run(100)
    end = world.poses()[0]
    assert end[:3, :3] == pytest.approx(start[:3, :3], abs=1e-6)
    steps, dt_s = count_steps(100, SIM.physics), SIM.physics.step_ms / 1000
    fall = np.array([0, 0, -9.81 * dt_s**2 * steps * (steps + 1) / 2])
    assert transform(end, com_obj[None]) - transform(start, com_obj[None]) == pytest.approx(
        fall[None], abs=1e-6
    )


def test_true_boxes_hold_the_posed_meshes(catalogue: Catalogue, world: World) -> None:
    bodies = [body_of("mug"), body_of("tri")]
    tilted = rigid(rotation_z(1.0), np.array([-0.1, 0.1, 0.1]))
    flat = upright(catalogue.meshes["tri"], bodies[1], np.array([0.12, -0.1]), 2.0)
    world.reset(bodies, np.stack([tilted, flat]), ORIGIN_TIP)
    step = world.step(0, ())
    for i, body in enumerate(bodies):
        vertices = catalogue.meshes[body.mesh].visual.vertices * body.scale_3
        center, size = aabb(transform(step.world_T_obj_N44[i], vertices))
        assert center == pytest.approx(step.center_N3[i], abs=1e-9)
        assert size == pytest.approx(step.size_N3[i], abs=1e-9)


def grid(num: int) -> Floats:
    reach = np.linspace(-SIM.robot.workspace_m, SIM.robot.workspace_m, num)
    return np.array([[x, y, SIM.robot.tip_height_m] for x in reach for y in reach])


def test_every_tip_of_the_workspace_is_reached_with_the_rod_upright(world: World) -> None:
    """Bullet's forward kinematics agrees with our inverse over the whole square, corners
    included.
    """
    world.reset([], np.zeros((0, 4, 4)), ORIGIN_TIP)
    for tip in grid(7):
        world.arm.reset_to(tip)
        rod = world.arm.world_T_link()[-1]
        assert rod[:3, 3] == pytest.approx(tip, abs=1e-6)
        assert rod[:3, 2] == pytest.approx([0, 0, -1], abs=1e-6)


@pytest.mark.parametrize(
    "tip", [(0.27, 0.0, 0.018), (0.0, -0.3, 0.018), (0.26, 0.26, 0.9), (-0.26, 0.0, 0.3)]
)
def test_tips_out_of_reach_are_refused(tip: tuple[float, float, float]) -> None:
    with pytest.raises(ReachError, match="cannot hold its rod vertical at"):
        joints_for(np.array([ORIGIN_TIP, tip]), SIM.robot)


@pytest.mark.parametrize("angle_deg", [0, 75, 150, 225, 300])
def test_the_tip_follows_a_line_at_constant_speed(
    angle_deg: float, catalogue: Catalogue, world: World
) -> None:
    """Pushing a body, from rest, at the longest action: under 3 mm RMS, at its height, upright."""
    direction = np.array([np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg)), 0.0])
    pose = upright(catalogue.meshes["rect"], body_of("rect"), 0.08 * direction[:2], 0.0)
    world.reset([body_of("rect")], pose[None], ORIGIN_TIP)
    squares = np.concatenate([world.push(0.06 * direction) for _ in range(3)])
    step = world.step(0, ())
    assert np.sqrt(squares.mean()) < 3e-3
    assert len(squares) == 3 * world.steps_per_action
    assert step.tip_world_3 == pytest.approx(ORIGIN_TIP + 0.18 * direction, abs=1e-3)
    assert step.world_T_link_L44[-1][:3, 2] == pytest.approx([0, 0, -1], abs=5e-3)
    assert step.contact_AA[ROBOT, FIRST_OBJECT]
    assert (step.world_T_obj_N44[0] - pose)[:3, 3] @ direction > 0.05


def test_the_drawn_robot_is_the_simulated_one(world: World) -> None:
    shape = robot_shape(SIM.robot)
    world.reset([], np.zeros((0, 4, 4)), ORIGIN_TIP)
    posed = [
        transform(T, link[0]) for T, link in zip(world.arm.world_T_link(), shape.links, strict=True)
    ]
    rod, everything = posed[-1], np.concatenate(posed)
    assert rod[:, 2].min() == pytest.approx(ORIGIN_TIP[2], abs=1e-6)
    assert np.hypot(*rod[:, :2].T).max() == pytest.approx(SIM.robot.rod_radius_m, abs=1e-6)
    assert everything[:, 2].min() == pytest.approx(
        0.0, abs=1e-3
    )  # the pedestal stands on the plane of the table top


def test_the_rig_looks_at_the_table_and_is_perturbed_afresh() -> None:
    first, second = rig(SIM.rig, np.random.default_rng(0)), rig(SIM.rig, np.random.default_rng(1))
    still = rig(replace(SIM.rig, jitter_deg=0.0, jitter_m=0.0), np.random.default_rng(0))
    assert [camera.name for camera in first] == [f"cam_{i:02d}" for i in range(27)]
    assert still[13].world_T_cam_44[:3, 3] == pytest.approx(
        [np.cos(np.radians(40)), 0, np.sin(np.radians(40)) + 0.1]
    )
    assert still[0].world_T_cam_44[1, 3] < 0 < still[8].world_T_cam_44[1, 3]
    for one, other, nominal in zip(first, second, still, strict=True):
        uv, depth = project(nominal.K_33, nominal.world_T_cam_44, np.array([[0.0, 0.0, 0.1]]))
        assert uv == pytest.approx(np.array([[64.0, 64.0]]))
        assert depth == pytest.approx([1.0])
        assert not np.allclose(one.world_T_cam_44, other.world_T_cam_44)
        moved = inverse(nominal.world_T_cam_44) @ one.world_T_cam_44
        assert np.linalg.norm(moved[:3, 3]) < 0.2
        assert np.degrees(np.arccos((np.trace(moved[:3, :3]) - 1) / 2)) < 7.5


@pytest.mark.parametrize(("duration_ms", "step_ms"), [(200, 3), (200, 0), (0, 4), (2, 4), (10, 4)])
def test_a_clock_that_does_not_divide_is_refused(
    duration_ms: int, step_ms: int, catalogue: Catalogue
) -> None:
    physics = replace(SIM.physics, step_ms=step_ms, timestep_ms=duration_ms)
    with pytest.raises(ValueError, match="no whole multiple"):
        World(catalogue, replace(SIM, physics=physics))


def test_params_of_the_wrong_kind_are_refused() -> None:
    with pytest.raises(ParamsError, match=r"physics\.step_ms"):
        from_json(to_json(SIM).replace('"step_ms":4', '"step_ms":"4"'), SimConfig)
    with pytest.raises(ParamsError, match=r"arm\.torque: unknown key"):
        from_json(to_json(SIM).replace('"max_torque_nm"', '"torque"'), SimConfig)


def test_the_closed_loop_pushes_from_anywhere_and_lowers_on_nothing(catalogue: Catalogue) -> None:
    body, rng = body_of("rect"), np.random.default_rng(0)
    pose = upright(catalogue.meshes["rect"], body, np.zeros(2), 0.3)
    with PushWorld(catalogue, SIM, settle_ms=400) as trial:
        trial.reset([body], pose[None], np.array([0.2, 0.2]))
        before = trial.step_now(rng)
        assert not trial.is_free(np.zeros(2))
        assert not trial.is_free(np.array([0.3, 0.0]))
        blocked = trial.push(np.zeros(2), np.array([0.05, 0, 0]), rng)
        assert blocked.world_T_obj_N44 == pytest.approx(before.world_T_obj_N44, abs=1e-4)
        after = trial.push(np.array([-0.07, 0.0]), np.array([0.06, 0, 0]), rng)
        assert after.tip_world_3 == pytest.approx([-0.01, 0, SIM.robot.tip_height_m], abs=1e-3)
        assert after.center_N3[0, 0] - before.center_N3[0, 0] > 0.02
        assert after.contact_AA[ROBOT, FIRST_OBJECT]
        assert after.t_ns == 2 * 600_000_000
        with pytest.raises(ReachError):
            trial.push(np.array([0.25, 0.0]), np.array([0.05, 0, 0]), rng)


def test_an_outline_is_the_shadow_of_the_posed_mesh(catalogue: Catalogue) -> None:
    mesh, body = catalogue.meshes["rect"], body_of("rect", (1.1, 0.9, 1.0))
    outline = body_footprint(mesh, body, upright(mesh, body, np.array([0.1, 0.05]), np.pi / 2))
    x, y = mesh.visual.extents[:2] * body.scale_3[:2]
    assert outline.area == pytest.approx(x * y, rel=1e-3)
    assert outline.bounds == pytest.approx(
        (0.1 - y / 2, 0.05 - x / 2, 0.1 + y / 2, 0.05 + x / 2), abs=1e-4
    )
