"""Shading normals: smooth where a surface curves, sharp at its edges."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.jit import jit
from oes.render.raster import Ints32

SMOOTH_COSINE = float(np.cos(np.radians(40)))  # faces at a smaller angle are one smooth surface
MERGE_M = 1e-5

Int64s = NDArray[np.int64]


def normal_maps(vertices_P3: NDArray[np.float32], faces_F3: Ints32) -> Floats:
    """Maps F44: rows 0 to 2, affine from a point of a face to its shading normal; row 3, the face's
    own normal. All in the obj frame, of any length.

    A corner's normal is the mean, weighted by area, of the faces around its vertex that meet
    smoothly; over the face it is interpolated linearly. Vertices within ``MERGE_M`` are merged.
    """
    vertices, faces = vertices_P3.astype(np.float32), faces_F3.astype(np.int32)
    return _cached_maps(vertices.tobytes(), faces.tobytes())


@lru_cache(maxsize=64)
def _cached_maps(vertices: bytes, faces: bytes) -> Floats:
    # Cached by content, as the links of an arm are the same in every scene.
    vertices_P3 = np.frombuffer(vertices, np.float32).reshape(-1, 3).astype(np.float64)
    faces_F3 = np.frombuffer(faces, np.int32).reshape(-1, 3)
    corner_vertex = _merge(vertices_P3)[faces_F3].ravel()
    order = np.argsort(corner_vertex, kind="stable")
    starts = np.searchsorted(corner_vertex[order], np.arange(len(vertices_P3) + 1))
    a_F3, b_F3, c_F3 = (vertices_P3[faces_F3[:, i]] for i in range(3))
    area_F3 = np.cross(b_F3 - a_F3, c_F3 - a_F3)
    normal_F33 = corner_normals(area_F3, order, starts)
    return _interpolation(a_F3, b_F3 - a_F3, c_F3 - a_F3, area_F3, normal_F33)


def _merge(vertices_P3: Floats) -> Int64s:
    """An index for every vertex, the same for those in one place."""
    if not len(vertices_P3):
        return np.zeros(0, dtype=np.int64)
    cells_P3 = np.round((vertices_P3 - vertices_P3.min(axis=0)) / MERGE_M).astype(np.int64)
    # 21 bits an axis hold 20 m; sorting one integer is faster than np.unique over rows.
    keys_P = (cells_P3[:, 0] << 42) + (cells_P3[:, 1] << 21) + cells_P3[:, 2]
    return np.unique(keys_P, return_inverse=True)[1]


@jit
def corner_normals(area_F3: Floats, order: Int64s, starts: Int64s) -> Floats:
    """Mean unit normal of every corner (F33).

    ``order`` lists the corners (3 * face + corner) vertex by vertex from ``starts``; ``area_F3``
    are normals as long as twice the face's area, so that their sum is weighted by area.
    """
    normal_F33 = np.zeros((len(area_F3), 3, 3))
    length_F = np.sqrt((area_F3 * area_F3).sum(axis=1))
    for vertex_i in range(len(starts) - 1):
        around = order[starts[vertex_i] : starts[vertex_i + 1]]
        for corner in around:
            face = corner // 3
            mean_3 = normal_F33[face, corner % 3]
            for other_corner in around:
                other = other_corner // 3
                cosine = (
                    area_F3[face, 0] * area_F3[other, 0]
                    + area_F3[face, 1] * area_F3[other, 1]
                    + area_F3[face, 2] * area_F3[other, 2]
                )
                if cosine >= SMOOTH_COSINE * length_F[face] * length_F[other]:
                    for axis in range(3):
                        mean_3[axis] += area_F3[other, axis]
            x, y, z = mean_3[0], mean_3[1], mean_3[2]
            length = np.sqrt(x * x + y * y + z * z) + 1e-30  # no division by 0 without area
            mean_3[0], mean_3[1], mean_3[2] = x / length, y / length, z / length
    return normal_F33


def _interpolation(
    a_F3: Floats, ab_F3: Floats, ac_F3: Floats, area_F3: Floats, normal_F33: Floats
) -> Floats:
    """Maps that take a, b and c of each face to its corners' normals."""
    # One affine map a face spares the shader the barycentric weights of every pixel.
    squared_F1 = (area_F3**2).sum(axis=1, keepdims=True)
    safe_F1 = np.where(squared_F1 > 0, squared_F1, np.inf)  # constant on faces without area
    to_b_F3 = np.cross(ac_F3, area_F3) / safe_F1  # gradient of the barycentric weight of b
    to_c_F3 = np.cross(area_F3, ab_F3) / safe_F1
    slope_F33 = (normal_F33[:, 1] - normal_F33[:, 0])[:, :, None] * to_b_F3[:, None]
    slope_F33 += (normal_F33[:, 2] - normal_F33[:, 0])[:, :, None] * to_c_F3[:, None]
    offset_F3 = normal_F33[:, 0] - np.einsum("fij,fj->fi", slope_F33, a_F3)
    maps_F44 = np.zeros((len(a_F3), 4, 4))
    maps_F44[:, :3, :3], maps_F44[:, :3, 3], maps_F44[:, 3, :3] = slope_F33, offset_F3, area_F3
    return maps_F44
