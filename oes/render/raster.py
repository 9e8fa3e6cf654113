"""Z-buffer rasteriser: which triangle every pixel centre sees first, and how near it is."""

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.render.compiled import compiled

Ints = NDArray[np.int32]

NEAR_M = 0.01
EDGE_SLACK = 1e-9  # barycentric; keeps a pixel centre that lies exactly on a shared edge from falling between


@compiled
def project_vertices(vertices_P3: Floats, start_M: Ints, cam_T_mesh_M44: Floats, K_33: Floats) -> tuple[Floats, Floats]:
    """Vertices in cam (P3, metres) and their pixels with inverse depth (P3: u, v, 1/z; zero where z < NEAR_M).

    ``start_M`` (M + 1 entries) are the rows at which each mesh's vertices start.
    """
    cam_P3 = np.empty_like(vertices_P3)
    pix_P3 = np.zeros_like(vertices_P3)
    for mesh_i in range(len(start_M) - 1):
        T = cam_T_mesh_M44[mesh_i]
        for i in range(start_M[mesh_i], start_M[mesh_i + 1]):
            x, y, z = vertices_P3[i, 0], vertices_P3[i, 1], vertices_P3[i, 2]
            cam_x = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
            cam_y = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
            cam_z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            cam_P3[i, 0], cam_P3[i, 1], cam_P3[i, 2] = cam_x, cam_y, cam_z
            if cam_z >= NEAR_M:
                inverse = 1.0 / cam_z
                pix_P3[i, 0] = (K_33[0, 0] * cam_x + K_33[0, 1] * cam_y) * inverse + K_33[0, 2]
                pix_P3[i, 1] = K_33[1, 1] * cam_y * inverse + K_33[1, 2]
                pix_P3[i, 2] = inverse
    return cam_P3, pix_P3


@compiled
def fill_triangle(a_3: Floats, b_3: Floats, c_3: Floats, face_i: int, nearness_HW: Floats, face_HW: Ints) -> None:
    """Draw one triangle that lies wholly before the camera, given as (u, v, 1/z); 1/z is affine in the image."""
    height, width = face_HW.shape
    left = max(0, int(np.ceil(min(a_3[0], b_3[0], c_3[0]) - 0.5)))
    right = min(width - 1, int(np.floor(max(a_3[0], b_3[0], c_3[0]) - 0.5)))
    if left > right:
        return
    top = max(0, int(np.ceil(min(a_3[1], b_3[1], c_3[1]) - 0.5)))
    bottom = min(height - 1, int(np.floor(max(a_3[1], b_3[1], c_3[1]) - 0.5)))
    area = (b_3[0] - a_3[0]) * (c_3[1] - a_3[1]) - (b_3[1] - a_3[1]) * (c_3[0] - a_3[0])
    if top > bottom or area == 0.0:
        return
    a_du, a_dv = (b_3[1] - c_3[1]) / area, (c_3[0] - b_3[0]) / area
    b_du, b_dv = (c_3[1] - a_3[1]) / area, (a_3[0] - c_3[0]) / area
    for row in range(top, bottom + 1):
        a_row = (row + 0.5 - c_3[1]) * a_dv
        b_row = (row + 0.5 - c_3[1]) * b_dv
        for column in range(left, right + 1):
            a = (column + 0.5 - c_3[0]) * a_du + a_row
            b = (column + 0.5 - c_3[0]) * b_du + b_row
            c = 1.0 - a - b
            if a >= -EDGE_SLACK and b >= -EDGE_SLACK and c >= -EDGE_SLACK:
                nearness = a * a_3[2] + b * b_3[2] + c * c_3[2]
                if nearness > nearness_HW[row, column]:
                    nearness_HW[row, column] = nearness
                    face_HW[row, column] = face_i


@compiled
def fill_crossing(
    a_3: Floats, b_3: Floats, c_3: Floats, K_33: Floats, face_i: int, nearness_HW: Floats, face_HW: Ints
) -> None:
    """Draw one triangle that crosses the near plane, given in cam: every pixel's ray meets its plane or not."""
    normal = np.cross(b_3 - a_3, c_3 - a_3)
    offset = np.dot(normal, a_3)
    if offset == 0.0:
        return
    to_a, to_b, to_c = np.cross(b_3, c_3) / offset, np.cross(c_3, a_3) / offset, np.cross(a_3, b_3) / offset
    for row in range(face_HW.shape[0]):
        y = (row + 0.5 - K_33[1, 2]) / K_33[1, 1]
        for column in range(face_HW.shape[1]):
            x = (column + 0.5 - K_33[0, 2] - K_33[0, 1] * y) / K_33[0, 0]
            a = to_a[0] * x + to_a[1] * y + to_a[2]
            b = to_b[0] * x + to_b[1] * y + to_b[2]
            c = to_c[0] * x + to_c[1] * y + to_c[2]
            nearness = a + b + c
            slack = -EDGE_SLACK * nearness
            if 0.0 < nearness <= 1.0 / NEAR_M and a >= slack and b >= slack and c >= slack:
                if nearness > nearness_HW[row, column]:
                    nearness_HW[row, column] = nearness
                    face_HW[row, column] = face_i


@compiled
def rasterise(
    cam_P3: Floats, pix_P3: Floats, faces_F3: Ints, K_33: Floats, height: int, width: int
) -> tuple[Floats, Ints]:
    """1/z of the nearest surface at every pixel centre (HW, 0 = nothing) and its triangle (HW, -1 = nothing).

    Triangles are two-sided; what is nearer than ``NEAR_M`` is not drawn, and a triangle without area never is.
    """
    nearness_HW = np.zeros((height, width))
    face_HW = np.full((height, width), -1, dtype=np.int32)
    for face_i in range(len(faces_F3)):
        a, b, c = faces_F3[face_i, 0], faces_F3[face_i, 1], faces_F3[face_i, 2]
        num_near = (pix_P3[a, 2] == 0.0) + (pix_P3[b, 2] == 0.0) + (pix_P3[c, 2] == 0.0)
        if num_near == 0:
            fill_triangle(pix_P3[a], pix_P3[b], pix_P3[c], face_i, nearness_HW, face_HW)
        elif num_near < 3:  # noqa: PLR2004
            fill_crossing(cam_P3[a], cam_P3[b], cam_P3[c], K_33, face_i, nearness_HW, face_HW)
    return nearness_HW, face_HW
