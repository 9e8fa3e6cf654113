"""A small rasteriser for pictures of single meshes: orthographic, smooth shading, a soft shadow on
the ground.
"""

import cv2
import numpy as np
import trimesh
from numba import njit
from numpy.typing import NDArray

from oes.episode import Floats

SAMPLES_PER_PIXEL = 2
AZIMUTH_DEG, ELEVATION_DEG = 58.0, 30.0
LIGHT_3 = np.array([0.50, 0.24, 0.83]) / np.linalg.norm([0.50, 0.24, 0.83])
CREASE_RAD = 0.6
MARGIN = 1.3


def portrait(
    mesh: trimesh.Trimesh, rgb_3: Floats, paper_3: Floats, size_px: int
) -> tuple[Floats, float]:
    """The mesh standing on a ground of colour ``paper_3``: an image (H, W, 3) in 0..1, and its
    pixels per metre.
    """
    smooth = trimesh.graph.smooth_shade(mesh, angle=CREASE_RAD)
    full_px = size_px * SAMPLES_PER_PIXEL
    eye_3 = _direction(np.radians(AZIMUTH_DEG), np.radians(ELEVATION_DEG))
    view_33, light_33 = _axes(eye_3), _axes(LIGHT_3)
    flat_P2 = smooth.vertices @ view_33[:2].T
    scale = full_px / (MARGIN * np.ptp(flat_P2, axis=0).max())
    middle_2 = (flat_P2.max(0) + flat_P2.min(0)) / 2
    face_HW, weight_HW3, depth_HW = raster(
        _pixels(smooth, view_33, scale, middle_2, full_px), full_px
    )
    rows, columns = np.mgrid[:full_px, :full_px] + 0.5
    plane_HW2 = np.stack([columns - full_px / 2, full_px / 2 - rows], 2) / scale + middle_2
    ground_HW = (mesh.bounds[0, 2] - plane_HW2[..., 1] * view_33[1, 2]) / view_33[2, 2]
    is_body_HW = face_HW >= 0
    world_HW3 = (
        plane_HW2 @ view_33[:2] + np.where(is_body_HW, depth_HW, ground_HW)[..., None] * view_33[2]
    )
    lit_HW = _lit(smooth, world_HW3, light_33, full_px)
    corner_HW3 = smooth.faces[np.maximum(face_HW, 0)]
    normal_HW3 = np.einsum("hwc,hwcd->hwd", weight_HW3, smooth.vertex_normals[corner_HW3])
    body_HW3 = _shade(normal_HW3, lit_HW, eye_3)[..., None] * rgb_3
    image_HW3 = np.where(
        is_body_HW[..., None], body_HW3, _ground(lit_HW, is_body_HW, full_px)[..., None] * paper_3
    )
    image_HW3 = paper_3 + (np.clip(image_HW3, 0, 1) - paper_3) * _vignette(full_px)[..., None]
    small = cv2.resize(image_HW3, (size_px, size_px), interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.float64), float(scale / SAMPLES_PER_PIXEL)


def raster(corner_F33: Floats, size_px: int) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Nearest face (H, W; -1: none), barycentric weights and depth (larger is nearer) of triangles
    in pixels.
    """
    face_HW = np.full((size_px, size_px), -1)
    weight_HW3 = np.zeros((size_px, size_px, 3))
    depth_HW = np.full((size_px, size_px), -np.inf)
    _fill(np.ascontiguousarray(corner_F33), face_HW, weight_HW3, depth_HW)
    return face_HW, weight_HW3, depth_HW


@njit(cache=True, error_model="numpy")
def _fill(
    corner_F33: Floats, face_HW: NDArray[np.int64], weight_HW3: Floats, depth_HW: Floats
) -> None:
    size = face_HW.shape[0]
    for face_i in range(corner_F33.shape[0]):
        (ax, ay, az), (bx, by, bz), (cx, cy, cz) = corner_F33[face_i]
        side = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(side) < 1e-9:
            continue
        for row in range(max(0, int(min(ay, by, cy))), min(size, int(max(ay, by, cy)) + 1)):
            for column in range(max(0, int(min(ax, bx, cx))), min(size, int(max(ax, bx, cx)) + 1)):
                x, y = column + 0.5, row + 0.5
                a = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / side
                b = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / side
                c = 1.0 - a - b
                depth = a * az + b * bz + c * cz
                if min(a, b, c) >= -1e-6 and depth > depth_HW[row, column]:
                    depth_HW[row, column] = depth
                    face_HW[row, column] = face_i
                    weight_HW3[row, column] = a, b, c


def _direction(azimuth_rad: float, elevation_rad: float) -> Floats:
    flat = np.cos(elevation_rad)
    return np.array([flat * np.cos(azimuth_rad), flat * np.sin(azimuth_rad), np.sin(elevation_rad)])


def _axes(toward_3: Floats) -> Floats:
    """Rows: right, up, and toward the eye."""
    right_3 = np.cross(np.array([0.0, 0.0, 1.0]), toward_3)
    right_3 /= np.linalg.norm(right_3)
    return np.stack([right_3, np.cross(toward_3, right_3), toward_3])


def _pixels(
    mesh: trimesh.Trimesh, axes_33: Floats, scale: float, middle_2: Floats, size_px: int
) -> Floats:
    """Triangles (F, 3, 3) as (column, row, depth in metres)."""
    seen_F33 = mesh.vertices[mesh.faces] @ axes_33.T
    flat_F32 = (seen_F33[..., :2] - middle_2) * scale * np.array([1, -1]) + size_px / 2
    return np.concatenate([flat_F32, seen_F33[..., 2:]], 2)


def _lit(mesh: trimesh.Trimesh, world_HW3: Floats, light_33: Floats, size_px: int) -> Floats:
    """1 where the light reaches a point, 0 in the mesh's own shadow."""
    flat_P2 = mesh.vertices @ light_33[:2].T
    middle_2 = (flat_P2.max(0) + flat_P2.min(0)) / 2
    scale = size_px / (1.02 * np.ptp(flat_P2, axis=0).max())
    _, _, depth_HW = raster(_pixels(mesh, light_33, scale, middle_2, size_px), size_px)
    seen_HW3 = world_HW3 @ light_33.T
    at = np.floor((seen_HW3[..., :2] - middle_2) * scale * np.array([1, -1]) + size_px / 2).astype(
        int
    )
    within_HW = ((at >= 0) & (at < size_px)).all(2)
    at = np.clip(at, 0, size_px - 1)
    bias = 0.012 * float(mesh.extents.max())
    return np.where(
        within_HW & (depth_HW[at[..., 1], at[..., 0]] > seen_HW3[..., 2] + bias), 0.0, 1.0
    )


def _shade(normal_HW3: Floats, lit_HW: Floats, eye_3: Floats) -> Floats:
    """Sky light from above, one sun, a touch of light from the eye; either side of a face is
    lit.
    """
    length_HW1 = np.linalg.norm(normal_HW3, axis=2, keepdims=True)
    normal_HW3 = normal_HW3 / np.maximum(length_HW1, 1e-9)
    normal_HW3 = normal_HW3 * np.where(normal_HW3 @ eye_3 < 0, -1, 1)[..., None]
    sun_HW = np.clip(normal_HW3 @ LIGHT_3, 0, 1) * cv2.GaussianBlur(lit_HW, (0, 0), 1.5)
    return np.asarray(
        0.40 + 0.18 * normal_HW3[..., 2] + 0.62 * sun_HW + 0.14 * np.clip(normal_HW3 @ eye_3, 0, 1)
    )


def _ground(lit_HW: Floats, is_body_HW: NDArray[np.bool_], size_px: int) -> Floats:
    """Brightness of the ground: the cast shadow, softened, and a faint dark halo where the mesh
    stands.
    """
    shadow_HW = cv2.GaussianBlur(np.where(is_body_HW, 0.6, 1 - lit_HW), (0, 0), size_px / 90)
    halo_HW = cv2.GaussianBlur(is_body_HW.astype(float), (0, 0), size_px / 22)
    return np.asarray(1 - 0.26 * shadow_HW - 0.10 * halo_HW)


def _vignette(size_px: int) -> Floats:
    """1 inside, falling to 0 over the outermost 8 % of the picture, so that shadows fade out before
    its edge.
    """
    rise_W = np.clip(
        np.minimum(np.arange(size_px), np.arange(size_px)[::-1]) / (0.08 * size_px), 0, 1
    )
    return np.outer(rise_W, rise_W)
