"""What the renderer draws: triangle meshes, each with its segmentation id, its pose's index and its
colouring.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from numpy.typing import NDArray

from oes.episode import SEG_FIRST_OBJECT, SEG_ROBOT, SEG_TABLE, Body, Floats, Step

if TYPE_CHECKING:
    from oes.meshes.catalogue import Catalogue
    from oes.sim.robot import RobotShape


@dataclass(frozen=True)
class RenderMesh:
    """One rigid triangle mesh in its own frame (metres).

    ``pose_i`` is its row in the poses given to ``Renderer.render``. It is coloured ``rgb_3``
    (0..1), or, where ``texture_seed`` is set, by the procedural texture of that seed; the table by
    its own fixed one.
    """

    vertices_P3: NDArray[np.float32]
    faces_F3: NDArray[np.int32]
    seg_id: int
    pose_i: int
    rgb_3: Floats
    texture_seed: int | None


def table_mesh(size_m_3: Floats) -> RenderMesh:
    """The table: a box whose top lies at z = 0, centred on the world's origin; its pose is row
    0.
    """
    box = trimesh.creation.box(extents=size_m_3)
    box.apply_translation([0.0, 0.0, -size_m_3[2] / 2])
    return _mesh(box.vertices, box.faces, SEG_TABLE, 0, np.full(3, 0.6), None)


def scene_meshes(
    table_size_m_3: Floats, robot: "RobotShape", bodies: Sequence[Body], catalogue: "Catalogue"
) -> list[RenderMesh]:
    """Table, robot links and objects, posed by ``mesh_poses``; objects scaled along their own axes.

    Raises KeyError when the catalogue lacks a body's mesh.
    """
    links = [
        _mesh(vertices, faces, SEG_ROBOT, 1 + link_i, rgb, None)
        for link_i, (vertices, faces, rgb) in enumerate(robot.links)
    ]
    objects = []
    for body_i, body in enumerate(bodies):
        visual = catalogue.meshes[body.mesh].visual
        vertices = visual.vertices * body.scale_3
        pose_i = 1 + len(links) + body_i
        objects.append(
            _mesh(
                vertices,
                visual.faces,
                SEG_FIRST_OBJECT + body_i,
                pose_i,
                np.full(3, 0.5),
                body.texture_seed,
            )
        )
    return [table_mesh(table_size_m_3), *links, *objects]


def mesh_poses(step: Step) -> Floats:
    """``world_T_mesh_M44`` of a state, in the order of ``scene_meshes``: the table, the links, the
    objects.
    """
    return np.concatenate([np.eye(4)[None], step.world_T_link_L44, step.world_T_obj_N44])


def _mesh(
    vertices: Floats,
    faces: NDArray[np.int32],
    seg_id: int,
    pose_i: int,
    rgb: Floats,
    texture_seed: int | None,
) -> RenderMesh:
    return RenderMesh(
        vertices_P3=np.ascontiguousarray(vertices, dtype=np.float32),
        faces_F3=np.ascontiguousarray(faces, dtype=np.int32),
        seg_id=seg_id,
        pose_i=pose_i,
        rgb_3=np.asarray(rgb, dtype=np.float64),
        texture_seed=texture_seed,
    )
