"""All views of one state at once: a compiled z-buffer rasteriser, then shading of what is seen.

Measured by ``benchmarks/render.py`` on table, arm and three objects, 27 views of 128 x 128 pixels:
about 7 times the views a second per core of a loop over Bullet's TinyRenderer with the same
outputs. Ray casting through Embree, inside projected rectangles and without the table, gave under 3
times for its hits alone: every state needs its tree rebuilt, and most triangles of an arm seen from
1 m are smaller than a pixel, which the rasteriser drops in a few nanoseconds.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oes.episode import SEG_NOTHING, Camera, Floats, Frames
from oes.geom.se3 import inverse
from oes.render.normals import normal_maps
from oes.render.raster import rasterise
from oes.render.scene import RenderMesh
from oes.render.shade import colour, lights, lit_points, sky
from oes.render.texture import texture_of


class Renderer:
    """Draws a fixed set of rigid meshes under any poses and cameras."""

    def __init__(self, meshes: Sequence[RenderMesh]) -> None:
        """Join the meshes into one list of vertices and faces and prepare their colouring."""
        self._start_M = np.cumsum([0, *(len(mesh.vertices_P3) for mesh in meshes)]).astype(np.int32)
        self._vertices_P3 = _joined(
            [mesh.vertices_P3.astype(np.float64) for mesh in meshes], (0, 3)
        )
        faces = [mesh.faces_F3 + start for mesh, start in zip(meshes, self._start_M, strict=False)]
        self._faces_F3 = _joined(faces, (0, 3)).astype(np.uint32)
        self._pose_i_M = np.array([mesh.pose_i for mesh in meshes], dtype=np.int32)
        self._normal_F44 = _joined(
            [normal_maps(mesh.vertices_P3, mesh.faces_F3) for mesh in meshes], (0, 4, 4)
        )
        num_faces = [len(mesh.faces_F3) for mesh in meshes]
        self._mesh_F = np.repeat(np.arange(len(meshes)), num_faces).astype(np.int32)
        seg_F = np.repeat([mesh.seg_id for mesh in meshes], num_faces)
        self._seg_F = np.append(seg_F, SEG_NOTHING).astype(np.uint8)  # the last is for no face (-1)
        textures = [texture_of(mesh) for mesh in meshes]
        self._paint = (
            np.array([texture.kind for texture in textures], dtype=np.int32),
            _joined([texture.rgb_23[None] for texture in textures], (0, 2, 3)),
            np.array([texture.cell_m for texture in textures], dtype=np.float64),
            _joined([texture.cell_T_obj_34[None] for texture in textures], (0, 3, 4)),
        )

    def render(self, world_T_mesh_M44: Floats, cameras: Sequence[Camera]) -> Frames:
        """Images from every camera (all of one size) of the meshes under the poses
        ``RenderMesh.pose_i`` refers to.

        The nearest surface at each pixel's centre is seen, from either side, beyond
        ``raster.NEAR_M``.
        """
        poses_M44 = world_T_mesh_M44[self._pose_i_M]
        lights_M23 = lights(poses_M44)
        views = [self._view(poses_M44, lights_M23, camera) for camera in cameras]
        return Frames(*(np.stack(images) for images in zip(*views, strict=True)))

    def _view(
        self, world_T_mesh_M44: Floats, lights_M23: Floats, camera: Camera
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]]:
        K_33, size = camera.K_33, (camera.height_px, camera.width_px)
        cam_T_mesh_M44 = inverse(camera.world_T_cam_44) @ world_T_mesh_M44
        depth, face = rasterise(
            self._vertices_P3, self._start_M, self._faces_F3, cam_T_mesh_M44, K_33, *size
        )
        lit = lit_points(
            depth, face, self._mesh_F, self._normal_F44, inverse(cam_T_mesh_M44), lights_M23, K_33
        )
        rgb = sky(camera.world_T_cam_44, K_33, *size)
        colour(lit, depth, face, K_33[0, 0], self._mesh_F, *self._paint, rgb)
        return rgb, depth.astype(np.float32), self._seg_F.take(face, mode="wrap")


def _joined(parts: list[Floats], empty_shape: tuple[int, ...]) -> Floats:
    """The parts one after another, or no rows at all when there are none."""
    return np.concatenate(parts) if parts else np.zeros(empty_shape)
