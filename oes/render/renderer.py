"""All views of one state at once."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oes.episode import Camera, Floats, Frames
from oes.geom.se3 import inverse
from oes.render.normals import normal_maps
from oes.render.raster import project_vertices, rasterise
from oes.render.scene import RenderMesh
from oes.render.shade import Paint, shade
from oes.render.texture import texture_of


class Renderer:
    """Draws a fixed set of rigid meshes under any poses and cameras."""

    def __init__(self, meshes: Sequence[RenderMesh]) -> None:
        """Join the meshes into one list of vertices and faces and prepare their colouring."""
        self._start_M = np.cumsum([0, *(len(mesh.vertices_P3) for mesh in meshes)]).astype(np.int32)
        self._vertices_P3 = _joined([mesh.vertices_P3.astype(np.float64) for mesh in meshes], (0, 3))
        faces = [mesh.faces_F3 + start for mesh, start in zip(meshes, self._start_M, strict=False)]
        self._faces_F3 = _joined(faces, (0, 3)).astype(np.int32)
        self._pose_i_M = np.array([mesh.pose_i for mesh in meshes], dtype=np.int32)
        self._paint = _paint(meshes)
        # the last entry is what a pixel without a face (-1) takes
        self._seg_F = np.append(np.repeat([m.seg_id for m in meshes], [len(m.faces_F3) for m in meshes]), 0)
        self._seg_F = self._seg_F.astype(np.uint8)

    def render(self, world_T_mesh_M44: Floats, cameras: Sequence[Camera]) -> Frames:
        """Images from every camera (all of one size) of the meshes under the poses ``RenderMesh.pose_i`` refers to.

        The nearest surface at each pixel's centre is seen, from either side, beyond ``raster.NEAR_M``.
        """
        poses_M44 = world_T_mesh_M44[self._pose_i_M]
        views = [self._view(poses_M44, camera) for camera in cameras]
        return Frames(*(np.stack(images) for images in zip(*views, strict=True)))

    def _view(
        self, world_T_mesh_M44: Floats, camera: Camera
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]]:
        cam_T_mesh_M44 = inverse(camera.world_T_cam_44) @ world_T_mesh_M44
        cam_P3, pix_P3 = project_vertices(self._vertices_P3, self._start_M, cam_T_mesh_M44, camera.K_33)
        nearness, face = rasterise(cam_P3, pix_P3, self._faces_F3, camera.K_33, camera.height_px, camera.width_px)
        rgb = shade(nearness, face, inverse(cam_T_mesh_M44), camera.world_T_cam_44, camera.K_33, self._paint)
        depth = np.divide(1.0, nearness, out=np.zeros_like(nearness), where=face >= 0).astype(np.float32)
        return rgb, depth, self._seg_F[face]


def _paint(meshes: Sequence[RenderMesh]) -> Paint:
    textures = [texture_of(mesh) for mesh in meshes]
    return Paint(
        mesh_F=np.repeat(np.arange(len(meshes)), [len(mesh.faces_F3) for mesh in meshes]).astype(np.int32),
        normal_T_obj_F34=_joined(
            [normal_maps(mesh.vertices_P3.astype(np.float64), mesh.faces_F3) for mesh in meshes], (0, 3, 4)
        ),
        kind_M=np.array([texture.kind for texture in textures], dtype=np.int32),
        rgb_M23=_joined([texture.rgb_23[None] for texture in textures], (0, 2, 3)),
        cell_m_M=np.array([texture.cell_m for texture in textures], dtype=np.float64),
        cell_T_obj_M34=_joined([texture.cell_T_obj_34[None] for texture in textures], (0, 3, 4)),
    )


def _joined(parts: list[Floats], empty_shape: tuple[int, ...]) -> Floats:
    """The parts one after another, or no rows at all when there are none."""
    return np.concatenate(parts) if parts else np.zeros(empty_shape)
