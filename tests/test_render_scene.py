"""Whole scenes: agreement with TinyRenderer, ids, textures, the same bytes every time."""

from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest
import trimesh

from benchmarks.render import random_state, write_catalogue
from benchmarks.tiny import TinyScene, as_tiny_samples, parity
from oes.config import load
from oes.episode import SEG_FIRST_OBJECT, SEG_ROBOT, SEG_TABLE, Body, Frames
from oes.geom.se3 import rigid, rotation_z
from oes.meshes.build import MeshesConfig
from oes.meshes.catalogue import Catalogue
from oes.render.renderer import Renderer
from oes.render.scene import scene_meshes, table_mesh
from oes.render.texture import SEEDED_KINDS, seeded_texture
from oes.sim.robot import robot_shape
from oes.sim.simulate import EpisodesConfig
from tests.blocks import read_sim
from tests.test_render_raster import cameras, mesh_of


@pytest.fixture(scope="module")
def catalogue(tmp_path_factory: pytest.TempPathFactory) -> Catalogue:
    return write_catalogue(
        load(Path("params.yaml"), "meshes", MeshesConfig), tmp_path_factory.mktemp("meshes")
    )


def digest(frames: Frames) -> str:
    return sha256(b"".join(image.tobytes() for image in vars(frames).values())).hexdigest()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_agrees_with_tiny_renderer(seed: int, catalogue: Catalogue, tmp_path: Path) -> None:
    cfg = load(Path("params.yaml"), "episodes", EpisodesConfig)
    meshes, poses, views = random_state(catalogue, cfg, np.random.default_rng(seed))
    ours = Renderer(meshes).render(poses, views)
    assert set(np.unique(ours.seg_VHW)) == {
        0,
        SEG_TABLE,
        SEG_ROBOT,
        *(SEG_FIRST_OBJECT + i for i in range(3)),
    }
    with TinyScene(meshes, poses, tmp_path) as tiny:
        depth_mm, equal = parity(ours, tiny.render([as_tiny_samples(camera) for camera in views]))
        shifted_mm, _ = parity(ours, tiny.render(views))
    assert depth_mm < 0.01
    assert equal > 0.999
    assert shifted_mm > 1  # the half pixel is real


def test_same_scene_gives_the_same_bytes(catalogue: Catalogue) -> None:
    cfg = load(Path("params.yaml"), "episodes", EpisodesConfig)
    scenes = [random_state(catalogue, cfg, np.random.default_rng(seed)) for seed in (5, 5, 6)]
    digests = [digest(Renderer(meshes).render(poses, views)) for meshes, poses, views in scenes]
    assert digests[0] == digests[1] != digests[2]


def test_bodies_are_scaled_along_their_own_axes(catalogue: Catalogue) -> None:
    sim, scale = read_sim(), np.array([0.9, 1.0, 1.1])
    body = Body("tri", "tri", scale, mass_kg=0.2, friction=0.4, texture_seed=3)
    robot = robot_shape(sim.robot)
    meshes = scene_meshes(np.array(sim.physics.table_size_m), robot, [body, body], catalogue)
    assert [mesh.pose_i for mesh in meshes] == list(range(1 + len(robot.links) + 2))
    assert [mesh.seg_id for mesh in meshes[-2:]] == [SEG_FIRST_OBJECT, SEG_FIRST_OBJECT + 1]
    assert np.allclose(
        np.ptp(meshes[-1].vertices_P3, axis=0),
        catalogue.meshes["tri"].extents_m_3 * scale,
        atol=1e-6,
    )
    with pytest.raises(KeyError, match="teapot"):
        scene_meshes(np.ones(3), robot, [replace(body, mesh="teapot")], catalogue)


def test_table_top_is_at_zero() -> None:
    table = table_mesh(np.array([0.6, 0.5, 0.05]))
    assert np.allclose(
        [table.vertices_P3.min(0), table.vertices_P3.max(0)], [[-0.3, -0.25, -0.05], [0.3, 0.25, 0]]
    )


@pytest.mark.parametrize("seed", range(12))
def test_turning_an_object_shows(seed: int) -> None:
    """A disc turned about its axis keeps its shape; its texture moves."""
    disc, camera = trimesh.creation.cylinder(0.05, 0.05, sections=72), cameras()[22]
    renderer = Renderer([mesh_of(disc, texture_seed=seed)])
    still, turned = (
        renderer.render(rigid(rotation_z(angle), np.zeros(3))[None], [camera])
        for angle in (0, np.pi / 6)
    )
    shows = still.seg_VHW[0] > 0
    assert np.array_equal(still.depth_m_VHW > 0, turned.depth_m_VHW > 0)
    change = np.abs(still.rgb_VHW3[0].astype(int) - turned.rgb_VHW3[0])[shows].max(-1)
    assert change.mean() > 10


def test_seeds_give_every_kind_of_texture_in_two_colours_apart() -> None:
    textures = [seeded_texture(seed) for seed in range(60)]
    assert {texture.kind for texture in textures} == set(SEEDED_KINDS)
    assert all(np.abs(np.diff(texture.rgb_23, axis=0)).max() > 0.25 for texture in textures)


def test_smooth_surfaces_shade_smoothly_and_edges_stay_sharp() -> None:
    """Neighbouring pixels of a coarse ball differ by little; those across a box's edge by much."""
    camera = cameras()[13]
    ball = Renderer([mesh_of(trimesh.creation.icosphere(2, 0.25))]).render(
        np.eye(4)[None], [camera]
    )
    box = Renderer([mesh_of(trimesh.creation.box([0.3] * 3))]).render(np.eye(4)[None], [camera])
    steps = []
    for frames in (ball, box):
        shows = frames.seg_VHW[0] > 0
        step = np.abs(np.diff(frames.rgb_VHW3[0, ..., 0].astype(int), axis=0))
        steps.append(step[shows[1:] & shows[:-1]].max())
    assert steps[0] < 20
    assert steps[1] > 25
