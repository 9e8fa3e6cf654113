"""All views of one state: a compiled z-buffer rasteriser, then deferred shading.

Measured by ``benchmarks/render.py`` on table, arm and three objects, 27 views of 128 x 128 pixels:
about 7 times the views a second per core of a loop over Bullet's TinyRenderer with the same
outputs. Ray casting through Embree gave under 3 times for its hits alone: every state needs its
tree rebuilt, and most triangles of an arm seen from 1 m are smaller than a pixel, which the
rasteriser drops in a few nanoseconds.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oes.episode import SEG_NOTHING, Camera, Floats, Frames
from oes.geom.se3 import inverse
from oes.render.normals import normal_maps
from oes.render.raster import Geometry, rasterise
from oes.render.scene import EMPTY_MESH, RenderMesh
from oes.render.shade import Textures, light_directions, lit_points, paint, sky
from oes.render.texture import texture_of


class Renderer:
    """Draws a fixed set of rigid meshes under any poses and cameras."""

    def __init__(self, meshes: Sequence[RenderMesh]) -> None:
        meshes = [*meshes, EMPTY_MESH]  # keeps every array's rank where there is no mesh
        num_faces = [len(mesh.faces_F3) for mesh in meshes]
        start_A = np.cumsum([0, *(len(mesh.vertices_P3) for mesh in meshes)]).astype(np.int32)
        faces = [mesh.faces_F3 + start for mesh, start in zip(meshes, start_A, strict=False)]
        self._geometry = Geometry(
            vertices_P3=np.concatenate([mesh.vertices_P3 for mesh in meshes]).astype(np.float64),
            start_A=start_A,
            faces_F3=np.concatenate(faces).astype(np.uint32),
            body_F=np.repeat(np.arange(len(meshes)), num_faces).astype(np.int32),
            normal_F44=np.concatenate([normal_maps(m.vertices_P3, m.faces_F3) for m in meshes]),
        )
        self._textures = Textures(*map(np.array, zip(*map(texture_of, meshes), strict=True)))
        self._pose_i_A = np.array([mesh.pose_i for mesh in meshes], dtype=np.int32)
        seg_F = np.repeat([mesh.seg_id for mesh in meshes], num_faces)
        self._seg_F = np.append(seg_F, SEG_NOTHING).astype(np.uint8)  # the last is for face -1

    def render(self, world_T_mesh_X44: Floats, cameras: Sequence[Camera]) -> Frames:
        """Images from cameras of one size, of the meshes at the poses ``RenderMesh.pose_i``.

        A pixel shows the nearest surface at its centre, from either side, beyond ``raster.NEAR_M``.
        """
        poses_A44 = world_T_mesh_X44[self._pose_i_A]
        lights_A23 = light_directions(poses_A44)
        views = [self._view(poses_A44, lights_A23, camera) for camera in cameras]
        return Frames(*(np.stack(images) for images in zip(*views, strict=True)))

    def _view(
        self, world_T_body_A44: Floats, lights_A23: Floats, camera: Camera
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.uint8]]:
        K_33, size_px = camera.K_33, (camera.height_px, camera.width_px)
        cam_T_body_A44 = inverse(camera.world_T_cam_44) @ world_T_body_A44
        depth, face = rasterise(self._geometry, cam_T_body_A44, K_33, size_px)
        lit = lit_points(depth, face, self._geometry, inverse(cam_T_body_A44), lights_A23, K_33)
        rgb = sky(camera.world_T_cam_44, K_33, size_px)
        paint(lit, depth, face, self._geometry, self._textures, K_33[0, 0], rgb)
        return rgb, depth.astype(np.float32), self._seg_F.take(face, mode="wrap")
