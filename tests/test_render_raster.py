"""Depth and segmentation against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from oes.episode import SEG_FIRST_OBJECT, SEG_ROBOT, Camera, Floats
from oes.geom.camera import intrinsics, look_at, unproject
from oes.geom.se3 import inverse, rigid, rotation_z, transform
from oes.render.renderer import Renderer
from oes.render.scene import RenderMesh
from oes.sim.rig import rig
from tests.blocks import read_sim

POSE = rigid(rotation_z(0.4), np.array([0.03, -0.02, 0.06]))
SIZE_M = np.array([0.2, 0.12, 0.08])


def mesh_of(
    triangles: trimesh.Trimesh, seg_id: int = SEG_FIRST_OBJECT, texture_seed: int | None = None
) -> RenderMesh:
    vertices, faces = triangles.vertices.astype(np.float32), triangles.faces.astype(np.int32)
    return RenderMesh(vertices, faces, seg_id, 0, np.full(3, 0.5), texture_seed)


def cameras(seed: int = 0) -> tuple[Camera, ...]:
    return rig(read_sim().rig, np.random.default_rng(seed))


def rays_obj(camera: Camera, world_T_obj: Floats) -> tuple[Floats, Floats]:
    """The camera's centre and, per pixel centre, the ray of unit depth (HW3), in obj."""
    v, u = np.mgrid[: camera.height_px, : camera.width_px] + 0.5
    rays_cam = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera.K_33).T
    obj_T_cam = inverse(world_T_obj) @ camera.world_T_cam_44
    return obj_T_cam[:3, 3], rays_cam @ obj_T_cam[:3, :3].T


def box_depth(camera: Camera, world_T_obj: Floats, size_3: Floats) -> Floats:
    """Depth of a box's nearest face at every pixel centre, 0 beside it, by slabs."""
    eye, rays = rays_obj(camera, world_T_obj)
    first, second = (-size_3 / 2 - eye) / rays, (size_3 / 2 - eye) / rays
    enter, leave = np.minimum(first, second).max(-1), np.maximum(first, second).min(-1)
    return np.where(enter <= leave, np.where(enter > 0, enter, leave).clip(0), 0)


def test_depth_of_a_box_from_every_camera() -> None:
    views = cameras()
    box = trimesh.creation.box(SIZE_M.astype(np.float32))
    frames = Renderer([mesh_of(box)]).render(POSE[None], views)
    for view_i, camera in enumerate(views):
        truth, depth = (
            box_depth(camera, POSE, SIZE_M.astype(np.float32).astype(float)),
            frames.depth_m_VHW[view_i],
        )
        assert ((truth > 0) != (depth > 0)).sum() <= 1  # a pixel centre on the silhouette, at most
        both = (truth > 0) & (depth > 0)
        assert both.sum() > 200
        assert np.abs(truth - depth)[both].max() < 1e-5
        assert np.array_equal(frames.seg_VHW[view_i], SEG_FIRST_OBJECT * (depth > 0))


def test_unprojected_depth_lies_on_the_true_surface() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.07)
    views = cameras(1)
    frames = Renderer([mesh_of(ball)]).render(POSE[None], views)
    for view_i, camera in enumerate(views):
        depth = torch.from_numpy(frames.depth_m_VHW[view_i]).double()
        world = unproject(
            torch.from_numpy(camera.K_33), torch.from_numpy(camera.world_T_cam_44), depth
        )
        on_ball = transform(inverse(POSE), world[depth > 0].numpy())
        radius = np.linalg.norm(on_ball, axis=1)
        assert len(radius) > 100
        assert (radius < 0.07 + 1e-6).all()
        assert (radius > 0.07 * 0.997).all()  # facets lie a little inside


def test_nearer_mesh_hides_the_farther_one_whatever_their_order() -> None:
    views = cameras(2)
    front, back = trimesh.creation.box([0.1] * 3), trimesh.creation.box([0.3, 0.3, 0.02])
    above = rigid(np.eye(3), np.array([0.0, 0.0, 0.06]))
    meshes = [mesh_of(front, SEG_FIRST_OBJECT), replace(mesh_of(back, SEG_ROBOT), pose_i=1)]
    poses = np.stack([above, np.eye(4)])
    one, other = (Renderer(order).render(poses, views) for order in (meshes, meshes[::-1]))
    assert np.array_equal(one.seg_VHW, other.seg_VHW)
    assert np.array_equal(one.depth_m_VHW, other.depth_m_VHW)
    for view_i, camera in enumerate(views):
        hits = box_depth(camera, above, np.full(3, 0.1)) > 0
        assert ((one.seg_VHW[view_i] == SEG_FIRST_OBJECT) != hits).sum() <= 1


@pytest.mark.parametrize("height_m", [0.02, 0.3])
def test_floor_that_runs_behind_the_camera(height_m: float) -> None:
    corners = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0]], float)
    floor = mesh_of(trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False))
    eye = np.array([0.0, 0.0, height_m])
    camera = Camera(
        "cam", intrinsics(60, 64, 48), look_at(eye, np.array([1.0, 0.1, height_m - 0.2])), 64, 48
    )
    depth = Renderer([floor]).render(np.eye(4)[None], [camera]).depth_m_VHW[0]
    eye, rays = rays_obj(camera, np.eye(4))
    truth = -eye[2] / rays[..., 2]
    inside = (truth > 0) & (np.abs(eye + truth[..., None] * rays)[..., :2] < 2).all(-1)
    assert inside[-1].all()
    assert not inside[0].any()
    assert np.array_equal(depth > 0, inside)
    assert np.abs(depth - truth)[inside].max() < 1e-5


def test_camera_within_a_box_sees_its_far_walls() -> None:
    size = np.array([1.0, 1.5, 0.5])
    camera = Camera(
        "cam", intrinsics(90, 40, 40), look_at(np.zeros(3), np.array([1.0, 0.3, 0.2])), 40, 40
    )
    depth = (
        Renderer([mesh_of(trimesh.creation.box(size))])
        .render(np.eye(4)[None], [camera])
        .depth_m_VHW[0]
    )
    assert np.allclose(depth, box_depth(camera, np.eye(4), size), atol=1e-6)


def test_meshes_behind_or_beside_the_view_are_not_drawn() -> None:
    box = mesh_of(trimesh.creation.box([0.1] * 3))
    camera = Camera(
        "cam", intrinsics(42, 32, 32), look_at(np.zeros(3), np.array([1.0, 0, 0])), 32, 32
    )
    poses = [
        rigid(np.eye(3), np.array(place)) for place in ((-0.5, 0, 0), (0.5, 3.0, 0), (0.5, 0, -3.0))
    ]
    for pose in poses:
        frames = Renderer([box]).render(pose[None], [camera])
        assert not frames.depth_m_VHW.any()
        assert not frames.seg_VHW.any()


def test_triangles_without_area_change_nothing() -> None:
    box = trimesh.creation.box(SIZE_M)
    flat = np.concatenate([box.faces, [[0, 0, 1], [2, 2, 2], [0, 1, 0]]])
    views = cameras()[:3]
    clean = Renderer([mesh_of(box)]).render(POSE[None], views)
    dirty = Renderer([mesh_of(trimesh.Trimesh(box.vertices, flat, process=False))]).render(
        POSE[None], views
    )
    assert all(
        np.array_equal(a, b)
        for a, b in zip(vars(clean).values(), vars(dirty).values(), strict=True)
    )


def test_empty_scene_is_all_sky() -> None:
    camera = cameras()[0]
    for meshes in ([], [mesh_of(trimesh.Trimesh(np.zeros((0, 3)), np.zeros((0, 3), int)))]):
        frames = Renderer(meshes).render(np.eye(4)[None], [camera])
        assert frames.rgb_VHW3.shape == (1, 128, 128, 3)
        assert not frames.depth_m_VHW.any()
        assert not frames.seg_VHW.any()
        assert frames.rgb_VHW3.min() > 100
    assert (frames.rgb_VHW3.dtype, frames.depth_m_VHW.dtype, frames.seg_VHW.dtype) == (
        np.uint8,
        np.float32,
        np.uint8,
    )
