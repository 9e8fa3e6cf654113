"""The rigid meshes of a scene: table, robot links and objects, with ids, poses and colours."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray

from oes.episode import SEG_FIRST_OBJECT, SEG_ROBOT, SEG_TABLE, Body, Floats, Step

if TYPE_CHECKING:  # types only: a stage that renders need not depend on Bullet
    from oes.meshes.catalogue import Catalogue
    from oes.sim.robot import RobotShape


@dataclass(frozen=True)
class RenderMesh:
    """One rigid triangle mesh in its own frame (m).

    ``pose_i`` is its row in the poses given to ``Renderer.render``. Its colour is ``rgb_3`` (0..1)
    or, if ``texture_seed`` is set, the procedural texture of that seed; the table has its own.
    """

    vertices_P3: NDArray[np.float32]
    faces_F3: NDArray[np.int32]
    seg_id: int
    pose_i: int
    rgb_3: Floats
    texture_seed: int | None


GREY_3 = np.full(3, 0.5)
EMPTY_MESH = RenderMesh(
    np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), SEG_TABLE, 0, GREY_3, None
)


def table_mesh(size_m_3: Floats) -> RenderMesh:
    """The table: a box with its top at z = 0, centred on the world's origin; pose 0."""
    box = trimesh.creation.box(extents=size_m_3)
    box.apply_translation([0.0, 0.0, -size_m_3[2] / 2])
    vertices, faces = box.vertices.astype(np.float32), box.faces.astype(np.int32)
    return RenderMesh(vertices, faces, SEG_TABLE, 0, np.full(3, 0.6), None)


def scene_meshes(
    table_size_m_3: Floats, robot: "RobotShape", bodies: Sequence[Body], catalogue: "Catalogue"
) -> list[RenderMesh]:
    """Table, robot links and objects (scaled along their own axes), posed by ``mesh_poses``.

    Raises KeyError if the catalogue lacks a body's mesh.
    """
    meshes = [table_mesh(table_size_m_3)]
    for vertices, faces, rgb in robot.links:
        points = vertices.astype(np.float32)
        meshes.append(RenderMesh(points, faces, SEG_ROBOT, len(meshes), rgb, None))
    for object_i, body in enumerate(bodies):
        visual = catalogue.meshes[body.mesh].visual
        points = (visual.vertices * body.scale_3).astype(np.float32)
        faces, seg_id, seed = visual.faces, SEG_FIRST_OBJECT + object_i, body.texture_seed
        meshes.append(RenderMesh(points, faces, seg_id, len(meshes), GREY_3, seed))
    return meshes


def mesh_poses(step: Step) -> Floats:
    """Poses ``world_T_mesh`` A44 of a state: the table, the links, the objects."""
    return np.concatenate([np.eye(4)[None], step.world_T_link_L44, step.world_T_obj_N44])
