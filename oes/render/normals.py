"""Shading normals: smooth where a surface curves, sharp at its edges."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.jit import jit
from oes.render.raster import Ints

SMOOTH_COSINE = float(
    np.cos(np.radians(40))
)  # faces that meet at a smaller angle are shaded as one surface
MERGE_M = 1e-5


def normal_maps(vertices_P3: NDArray[np.float32], faces_F3: Ints) -> Floats:
    """F44: rows 0 to 2, the affine map from a point of a face (obj frame) to its shading normal
    there (obj frame, any length); row 3, the face's own normal (any length).

    A corner's normal is the mean of the faces around its vertex that meet smoothly, weighted by
    area; over the face it is interpolated linearly. Vertices within ``MERGE_M`` count as one.
    """
    return _cached_maps(
        vertices_P3.astype(np.float32).tobytes(), faces_F3.astype(np.int32).tobytes()
    )


@lru_cache(maxsize=64)
def _cached_maps(vertices: bytes, faces: bytes) -> Floats:
    """By content: an arm's links come again in every scene."""
    vertices_P3 = np.frombuffer(vertices, np.float32).reshape(-1, 3).astype(np.float64)
    faces_F3 = np.frombuffer(faces, np.int32).reshape(-1, 3)
    merged_P = _merge(vertices_P3)
    corner_vertex = merged_P[faces_F3].ravel()
    order = np.argsort(corner_vertex, kind="stable")
    starts = np.searchsorted(corner_vertex[order], np.arange(len(vertices_P3) + 1))
    a_F3, b_F3, c_F3 = (vertices_P3[faces_F3[:, i]] for i in range(3))
    area_F3 = np.cross(b_F3 - a_F3, c_F3 - a_F3)
    normal_F33 = corner_normals(area_F3, order // 3, order % 3, starts)
    return _interpolation(a_F3, b_F3 - a_F3, c_F3 - a_F3, area_F3, normal_F33)


def _merge(vertices_P3: Floats) -> NDArray[np.int64]:
    """A number for every vertex, the same for those in one place."""
    if not len(vertices_P3):
        return np.zeros(0, dtype=np.int64)
    cells_P3 = np.round((vertices_P3 - vertices_P3.min(axis=0)) / MERGE_M).astype(np.int64)
    keys_P = (cells_P3[:, 0] << 42) + (cells_P3[:, 1] << 21) + cells_P3[:, 2]
    return np.unique(keys_P, return_inverse=True)[1]


@jit
def corner_normals(
    area_F3: Floats,
    corner_face: NDArray[np.int64],
    corner_i: NDArray[np.int64],
    starts: NDArray[np.int64],
) -> Floats:
    """Mean unit normal of every corner (F33); ``corner_*`` list the corners vertex by vertex from
    ``starts``.
    """
    normal_F33 = np.zeros((len(area_F3), 3, 3))
    length_F = np.sqrt((area_F3 * area_F3).sum(axis=1))
    for vertex_i in range(len(starts) - 1):
        for i in range(starts[vertex_i], starts[vertex_i + 1]):
            face, corner = corner_face[i], corner_i[i]
            x, y, z = 0.0, 0.0, 0.0
            for j in range(starts[vertex_i], starts[vertex_i + 1]):
                other = corner_face[j]
                cosine = (
                    area_F3[face, 0] * area_F3[other, 0]
                    + area_F3[face, 1] * area_F3[other, 1]
                    + area_F3[face, 2] * area_F3[other, 2]
                )
                if cosine >= SMOOTH_COSINE * length_F[face] * length_F[other]:
                    x, y, z = x + area_F3[other, 0], y + area_F3[other, 1], z + area_F3[other, 2]
            length = np.sqrt(x * x + y * y + z * z) + 1e-30
            normal_F33[face, corner, 0] = x / length
            normal_F33[face, corner, 1] = y / length
            normal_F33[face, corner, 2] = z / length
    return normal_F33


def _interpolation(
    a_F3: Floats, ab_F3: Floats, ac_F3: Floats, area_F3: Floats, normal_F33: Floats
) -> Floats:
    """Maps that take a, b and c of each face to its corners' normals; constant on faces without
    area.
    """
    squared_F1 = (area_F3**2).sum(axis=1, keepdims=True)
    safe_F1 = np.where(squared_F1 > 0, squared_F1, np.inf)
    to_b_F3 = np.cross(ac_F3, area_F3) / safe_F1  # the weight of b grows by this per metre
    to_c_F3 = np.cross(area_F3, ab_F3) / safe_F1
    slope_F33 = (normal_F33[:, 1] - normal_F33[:, 0])[:, :, None] * to_b_F3[:, None]
    slope_F33 += (normal_F33[:, 2] - normal_F33[:, 0])[:, :, None] * to_c_F3[:, None]
    offset_F3 = normal_F33[:, 0] - np.einsum("fij,fj->fi", slope_F33, a_F3)
    maps_F44 = np.zeros((len(a_F3), 4, 4))
    maps_F44[:, :3, :3], maps_F44[:, :3, 3], maps_F44[:, 3, :3] = slope_F33, offset_F3, area_F3
    return maps_F44
