"""Baseline renderer: Bullet's TinyRenderer, called once per view on the same triangles."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
import pybullet
import trimesh

from oes.episode import Camera, Floats, Frames
from oes.geom.se3 import inverse, quat_xyzw
from oes.render.scene import RenderMesh

NEAR_M, FAR_M = 0.1, 5.0


class TinyScene:
    """A context manager with posed meshes in its own Bullet client; no shadows."""

    def __init__(
        self, meshes: Sequence[RenderMesh], world_T_mesh_A44: Floats, folder: Path
    ) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        # By body; the last entry is for no body (-1).
        self._seg_of = np.zeros(len(meshes) + 1, np.uint8)
        for mesh_i, mesh in enumerate(meshes):
            path = folder / f"{mesh_i}.obj"
            triangles = trimesh.Trimesh(mesh.vertices_P3, mesh.faces_F3, process=False)
            path.write_text(trimesh.exchange.obj.export_obj(triangles, digits=9))
            shape = pybullet.createVisualShape(
                pybullet.GEOM_MESH,
                fileName=str(path),
                rgbaColor=[0.5, 0.5, 0.5, 1],
                physicsClientId=self._client,
            )
            T = world_T_mesh_A44[mesh.pose_i]
            pose = T[:3, 3].tolist(), quat_xyzw(T[:3, :3]).tolist()
            body = pybullet.createMultiBody(0, -1, shape, *pose, physicsClientId=self._client)
            self._seg_of[body] = mesh.seg_id

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pybullet.disconnect(self._client)

    def render(self, cameras: Sequence[Camera]) -> Frames:
        """Images as of ``Renderer.render``, between the planes NEAR_M and FAR_M."""
        views = [self._view(camera) for camera in cameras]
        return Frames(*(np.stack(images) for images in zip(*views, strict=True)))

    def _view(self, camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        matrices = [matrix.T.ravel().tolist() for matrix in gl_matrices(camera)]
        _, _, rgba, buffer, body = pybullet.getCameraImage(
            camera.width_px, camera.height_px, *matrices,
            shadow=0, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=self._client,
        )  # fmt: skip
        shape = (camera.height_px, camera.width_px)
        buffer = np.asarray(buffer).reshape(shape)
        depth = FAR_M * NEAR_M / (FAR_M - (FAR_M - NEAR_M) * buffer) * (buffer < 1)
        rgb = np.asarray(rgba, np.uint8).reshape(*shape, 4)[..., :3]
        return rgb, depth.astype(np.float32), self._seg_of[np.asarray(body).reshape(shape)]


def gl_matrices(camera: Camera) -> tuple[Floats, Floats]:
    """OpenGL's view and projection matrices of a camera, for column vectors."""
    (fx, _, cx), (_, fy, cy), _ = camera.K_33
    width, height, range_m = camera.width_px, camera.height_px, FAR_M - NEAR_M
    projection = np.array(
        [
            [2 * fx / width, 0, 1 - 2 * cx / width, 0],
            [0, 2 * fy / height, 2 * cy / height - 1, 0],
            [0, 0, -(FAR_M + NEAR_M) / range_m, -2 * FAR_M * NEAR_M / range_m],
            [0, 0, -1, 0],
        ]
    )
    return np.diag([1.0, -1.0, -1.0, 1.0]) @ inverse(camera.world_T_cam_44), projection


def as_tiny_samples(camera: Camera) -> Camera:
    """The camera with which TinyRenderer samples the points of ``Renderer``.

    It samples at the lower left corner of a pixel, not at its centre: half a pixel off each way.
    """
    K_33 = camera.K_33.copy()
    K_33[:2, 2] += [-0.5, 0.5]
    return replace(camera, K_33=K_33)


def parity(ours: Frames, tiny: Frames) -> tuple[float, float]:
    """Median depth difference (mm) away from edges of equal segments, and share of equal ids."""
    same = ours.seg_VHW == tiny.seg_VHW
    inside = same & (ours.seg_VHW > 0)
    for axis, shift in ((1, 1), (1, -1), (2, 1), (2, -1)):
        inside &= ours.seg_VHW == np.roll(ours.seg_VHW, shift, axis)
    error_m = np.abs(ours.depth_m_VHW - tiny.depth_m_VHW)[inside]
    return 1000 * float(np.median(error_m)), float(same.mean())
