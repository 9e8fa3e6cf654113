"""Z-buffer rasteriser: the nearest triangle at every pixel centre and its depth."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.jit import jit

Ints32 = NDArray[np.int32]
Indices = NDArray[np.uint32]  # unsigned: numba then omits the test for negative ones

NEAR_M = 0.01
EDGE_SLACK = 1e-9  # barycentric: a pixel centre on a shared edge must not fall between triangles
BEHIND = -1  # cell of a vertex nearer than NEAR_M


class Geometry(NamedTuple):
    """The triangles of A rigid bodies: P vertices and F faces, body after body.

    ``start_A`` (A + 1 entries) are the rows at which each body's vertices start, ``body_F`` is the
    body of each face, ``normal_F44`` its ``normals.normal_maps``.
    """

    vertices_P3: Floats
    start_A: Ints32
    faces_F3: Indices
    body_F: Ints32
    normal_F44: Floats


@jit
def rasterise(
    geometry: Geometry, cam_T_body_A44: Floats, K_33: Floats, size_px: tuple[int, int]
) -> tuple[Floats, Ints32]:
    """Depth (H W, m, 0 = nothing) and triangle (H W, -1 = nothing) at every pixel centre.

    Triangles are two-sided; nothing nearer than ``NEAR_M`` and none without area is drawn.
    """
    faces_F3 = geometry.faces_F3
    cam_P3, pix_P3, cell_P2 = project_vertices(geometry, cam_T_body_A44, K_33, size_px)
    inv_z_HW = np.zeros(size_px)
    face_HW = np.full(size_px, -1, dtype=np.int32)
    whole_F, crossing_F = covering_faces(cell_P2, faces_F3)
    fill_triangles(pix_P3, cell_P2, faces_F3, whole_F, inv_z_HW, face_HW)
    for face_i in crossing_F:
        fill_crossing(cam_P3, K_33, faces_F3, face_i, inv_z_HW, face_HW)
    return np.where(inv_z_HW > 0.0, 1.0 / inv_z_HW, 0.0), face_HW


@jit
def project_vertices(
    geometry: Geometry, cam_T_body_A44: Floats, K_33: Floats, size_px: tuple[int, int]
) -> tuple[Floats, Floats, Ints32]:
    """Vertices in cam (P3, m), in the image (P3: u - 1/2, v - 1/2, 1/z) and their cells (P2).

    A cell (column, row) is the first pixel centre at or beyond the vertex, clipped to the image. A
    triangle whose cells agree in column or in row covers no pixel centre. A vertex nearer than
    ``NEAR_M`` has 1/z = 0 and the cell ``BEHIND``.
    """
    vertices_P3, start_A = geometry.vertices_P3, geometry.start_A
    height, width = size_px
    cam_P3 = np.empty_like(vertices_P3)
    pix_P3 = np.zeros_like(vertices_P3)
    cell_P2 = np.full((len(vertices_P3), 2), BEHIND, dtype=np.int32)
    for body_i in range(len(start_A) - 1):
        for i in range(start_A[body_i], start_A[body_i + 1]):
            x, y, z = vertices_P3[i, 0], vertices_P3[i, 1], vertices_P3[i, 2]
            cam_x, cam_y, cam_z = affine(cam_T_body_A44, body_i, x, y, z)
            cam_P3[i, 0], cam_P3[i, 1], cam_P3[i, 2] = cam_x, cam_y, cam_z
            if cam_z >= NEAR_M:
                inv_z = 1.0 / cam_z
                # 1/z, unlike z, is affine in the image, so that it interpolates linearly there.
                u = (K_33[0, 0] * cam_x + K_33[0, 1] * cam_y) * inv_z + K_33[0, 2] - 0.5
                v = K_33[1, 1] * cam_y * inv_z + K_33[1, 2] - 0.5
                pix_P3[i, 0], pix_P3[i, 1], pix_P3[i, 2] = u, v, inv_z
                cell_P2[i, 0] = int(np.ceil(min(max(u, 0.0), float(width))))
                cell_P2[i, 1] = int(np.ceil(min(max(v, 0.0), float(height))))
    return cam_P3, pix_P3, cell_P2


@jit
def covering_faces(cell_P2: Ints32, faces_F3: Indices) -> tuple[Indices, Indices]:
    """Triangles that may cover a pixel centre: those before the near plane, and those across it.

    Most triangles of an arm or a mug seen from 1 m are smaller than a pixel and cover none.
    """
    whole_F = np.empty(len(faces_F3), dtype=np.uint32)
    crossing_F = np.empty(len(faces_F3), dtype=np.uint32)
    num_whole = num_crossing = 0
    for face_i in range(len(faces_F3)):
        a, b, c = faces_F3[face_i, 0], faces_F3[face_i, 1], faces_F3[face_i, 2]
        columns = (cell_P2[a, 0] ^ cell_P2[b, 0]) | (cell_P2[b, 0] ^ cell_P2[c, 0])
        rows = (cell_P2[a, 1] ^ cell_P2[b, 1]) | (cell_P2[b, 1] ^ cell_P2[c, 1])
        is_behind = (cell_P2[a, 0] | cell_P2[b, 0] | cell_P2[c, 0]) < 0
        is_covering = (columns != 0) & (rows != 0)
        # Always written, kept only if counted: a branch here would often be mispredicted.
        whole_F[num_whole] = crossing_F[num_crossing] = face_i
        num_whole += is_covering & (not is_behind)
        num_crossing += is_covering & is_behind
    return whole_F[:num_whole], crossing_F[:num_crossing]


@jit
def fill_triangles(
    pix_P3: Floats,
    cell_P2: Ints32,
    faces_F3: Indices,
    whole_F: Indices,
    inv_z_HW: Floats,
    face_HW: Ints32,
) -> None:
    """Draw triangles that are wholly before the near plane, by barycentric weights a, b, c."""
    for face_i in whole_F:
        a_i, b_i, c_i = faces_F3[face_i, 0], faces_F3[face_i, 1], faces_F3[face_i, 2]
        a_u, a_v, a_inv_z = pix_P3[a_i, 0], pix_P3[a_i, 1], pix_P3[a_i, 2]
        b_u, b_v, b_inv_z = pix_P3[b_i, 0], pix_P3[b_i, 1], pix_P3[b_i, 2]
        c_u, c_v, c_inv_z = pix_P3[c_i, 0], pix_P3[c_i, 1], pix_P3[c_i, 2]
        area = (b_u - a_u) * (c_v - a_v) - (b_v - a_v) * (c_u - a_u)
        if area == 0.0:
            continue
        # The weights are affine in the image. Dividing by the signed area makes them positive
        # inside whatever the winding.
        a_du, a_dv = (b_v - c_v) / area, (c_u - b_u) / area
        b_du, b_dv = (c_v - a_v) / area, (a_u - c_u) / area
        left = min(cell_P2[a_i, 0], cell_P2[b_i, 0], cell_P2[c_i, 0])
        right = max(cell_P2[a_i, 0], cell_P2[b_i, 0], cell_P2[c_i, 0])
        top = min(cell_P2[a_i, 1], cell_P2[b_i, 1], cell_P2[c_i, 1])
        bottom = max(cell_P2[a_i, 1], cell_P2[b_i, 1], cell_P2[c_i, 1])
        # Unsigned loop variables spare a third of the time: no test for negative indices.
        for row in range(np.uint64(top), np.uint64(bottom)):
            a_row = (row - c_v) * a_dv - c_u * a_du
            b_row = (row - c_v) * b_dv - c_u * b_du
            for column in range(np.uint64(left), np.uint64(right)):
                a, b = column * a_du + a_row, column * b_du + b_row
                c = 1.0 - a - b
                if min(a, b, c) >= -EDGE_SLACK:
                    inv_z = a * a_inv_z + b * b_inv_z + c * c_inv_z
                    if inv_z > inv_z_HW[row, column]:
                        inv_z_HW[row, column] = inv_z
                        face_HW[row, column] = face_i


@jit
def fill_crossing(
    cam_P3: Floats, K_33: Floats, faces_F3: Indices, face_i: int, inv_z_HW: Floats, face_HW: Ints32
) -> None:
    """Draw one triangle that crosses the near plane, by the intersection of every pixel's ray.

    A ray (x, y, 1) = z^-1 (a A + b B + c C) has a, b, c from the inverse of the matrix [A B C].
    """
    # A vertex behind the camera has no projection: work in 3D, where none is needed.
    a_i, b_i, c_i = faces_F3[face_i, 0], faces_F3[face_i, 1], faces_F3[face_i, 2]
    a_3, b_3, c_3 = cam_P3[a_i], cam_P3[b_i], cam_P3[c_i]
    to_a, to_b, to_c = np.cross(b_3, c_3), np.cross(c_3, a_3), np.cross(a_3, b_3)
    volume = np.dot(a_3, to_a)
    if volume == 0.0:
        return  # seen edge on
    for row in range(face_HW.shape[0]):
        y = (row + 0.5 - K_33[1, 2]) / K_33[1, 1]
        for column in range(face_HW.shape[1]):
            x = (column + 0.5 - K_33[0, 2] - K_33[0, 1] * y) / K_33[0, 0]
            a = (to_a[0] * x + to_a[1] * y + to_a[2]) / volume
            b = (to_b[0] * x + to_b[1] * y + to_b[2]) / volume
            c = (to_c[0] * x + to_c[1] * y + to_c[2]) / volume
            inv_z = a + b + c
            is_inside = min(a, b, c) >= -EDGE_SLACK * inv_z
            if is_inside and inv_z_HW[row, column] < inv_z <= 1.0 / NEAR_M:
                inv_z_HW[row, column] = inv_z
                face_HW[row, column] = face_i


@jit
def affine(T_X34: Floats, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The point (x, y, z) under the affine map ``T_X34[i]``; a fourth row is ignored."""
    x, y, z = linear(T_X34, i, x, y, z)
    return x + T_X34[i, 0, 3], y + T_X34[i, 1, 3], z + T_X34[i, 2, 3]


@jit
def linear(T_X34: Floats, i: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The direction (x, y, z) under the linear part of ``T_X34[i]``."""
    # Written out and indexed in place: slices and small matrix products are slow in numba.
    return (
        T_X34[i, 0, 0] * x + T_X34[i, 0, 1] * y + T_X34[i, 0, 2] * z,
        T_X34[i, 1, 0] * x + T_X34[i, 1, 1] * y + T_X34[i, 1, 2] * z,
        T_X34[i, 2, 0] * x + T_X34[i, 2, 1] * y + T_X34[i, 2, 2] * z,
    )
