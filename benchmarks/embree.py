"""An alternative renderer: ray casting with Embree, first hits only, without shading."""

from collections.abc import Sequence

import numpy as np
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from oes.episode import SEG_TABLE, Camera, Floats
from oes.geom.camera import project
from oes.geom.se3 import transform
from oes.render.scene import RenderMesh

CORNERS_83 = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(8, 3)


def cast(meshes: Sequence[RenderMesh], world_T_mesh_A44: Floats, cameras: Sequence[Camera]) -> int:
    """Number of hits in all views, with rays only inside the box of each mesh in the image.

    Without the table, whose hits have a closed form.
    """
    bodies = [mesh for mesh in meshes if mesh.seg_id != SEG_TABLE]
    points = [
        transform(world_T_mesh_A44[mesh.pose_i], mesh.vertices_P3.astype(np.float64))
        for mesh in bodies
    ]
    triangles = [vertices[mesh.faces_F3] for vertices, mesh in zip(points, bodies, strict=True)]
    scene = rtcore_scene.EmbreeScene()
    TriangleMesh(scene, np.concatenate(triangles).astype(np.float32))
    lows, highs = np.stack([p.min(0) for p in points]), np.stack([p.max(0) for p in points])
    corners_A83 = lows[:, None] + CORNERS_83 * (highs - lows)[:, None]
    return sum(_hits(scene, corners_A83, camera) for camera in cameras)


def _hits(scene: rtcore_scene.EmbreeScene, corners_A83: Floats, camera: Camera) -> int:
    uv, depth = project(camera.K_33, camera.world_T_cam_44, corners_A83)
    limit = np.array([camera.width_px, camera.height_px])
    wanted = np.zeros((camera.height_px, camera.width_px), bool)
    for corners, near in zip(uv, depth.min(axis=1), strict=True):
        box = np.clip([corners.min(0), corners.max(0) + 1], 0, limit).astype(int)
        low, high = box if near > 0 else (0 * limit, limit)
        wanted[low[1] : high[1], low[0] : high[0]] = True
    v, u = np.nonzero(wanted)
    rays_cam = np.stack([u + 0.5, v + 0.5, np.ones(len(u))], axis=1) @ np.linalg.inv(camera.K_33).T
    directions = (rays_cam @ camera.world_T_cam_44[:3, :3].T).astype(np.float32)
    origins = np.broadcast_to(camera.world_T_cam_44[:3, 3].astype(np.float32), directions.shape)
    hits = scene.run(np.ascontiguousarray(origins), directions, output=True)
    return int((hits["primID"] >= 0).sum())
