"""Deferred shading: the colour of every pixel from the triangle it sees, compiled; a sky where it
sees none.
"""

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.jit import jit
from oes.render.raster import Ints

PLAIN, CHECKER, STRIPES, NOISE, GRADIENT, WOOD = 0, 1, 2, 3, 4, 5

TO_LAMP_3 = np.array([0.42, -0.38, 0.82])
AMBIENT, SKY_LIGHT, LAMP_LIGHT = (
    0.41,
    0.11,
    0.55,
)  # everywhere; more from above, less from below; from the lamp
HORIZON_RGB_3, ZENITH_RGB_3 = np.array([0.90, 0.92, 0.94]), np.array([0.62, 0.70, 0.80])
LATTICE_SIZE = 4096
LATTICE = np.random.default_rng(0).random(LATTICE_SIZE)
PLANKS_PER_M, GRAINS_PER_M, GRAIN_ASPECT = 1 / 0.15, 1 / 0.012, 1 / 12
GRID_M, LINE_M = 0.10, 0.003


@jit
def lattice_value(x: int, y: int, z: int) -> float:
    """A fixed pseudo-random number in 0..1 at a lattice point."""
    return float(LATTICE[((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (LATTICE_SIZE - 1)])


@jit
def plane_noise(x: float, y: float, z: int) -> float:
    """Smooth noise in 0..1 over x and y, another for every z: lattice values blended by
    smoothstep.
    """
    i, j = int(np.floor(x)), int(np.floor(y))
    u, v = x - i, y - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)
    front = lattice_value(i, j, z) * (1 - u) + lattice_value(i + 1, j, z) * u
    back = lattice_value(i, j + 1, z) * (1 - u) + lattice_value(i + 1, j + 1, z) * u
    return front * (1 - v) + back * v


@jit
def value_noise(x: float, y: float, z: float) -> float:
    """Smooth noise in 0..1 over space."""
    k = int(np.floor(z))
    w = z - k
    w = w * w * (3 - 2 * w)
    return plane_noise(x, y, k) * (1 - w) + plane_noise(x, y, k + 1) * w


@jit
def soft_square(x: float, softness: float) -> float:
    """A square wave of period 2 between -1 and 1 whose edges are ``softness`` wide."""
    phase = x - 2.0 * np.floor(x * 0.5)
    edge = 0.5 - abs(phase - 1.0)  # distance to the nearest edge, negative in the other half
    return float(max(-1.0, min(1.0, 2.0 * edge / softness)))


@jit
def wood(x: float, y: float, pixel_m: float) -> float:
    """The table: planks along x with a faint grain, and a thin grid every ``GRID_M``."""
    plank = int(np.floor(y * PLANKS_PER_M))
    tone = 0.35 * lattice_value(plank, 7, 7)
    grain = 0.35 * plane_noise(x * (GRAINS_PER_M * GRAIN_ASPECT), y * GRAINS_PER_M, plank)
    u, v = x * (1 / GRID_M), y * (1 / GRID_M)
    to_line = min(abs(u - np.floor(u + 0.5)), abs(v - np.floor(v + 0.5))) * GRID_M
    if to_line > LINE_M + 0.5 * pixel_m:
        return float(tone + grain)
    cover = min(1.0, 0.5 + (LINE_M - to_line) / pixel_m) * min(1.0, 2 * LINE_M / pixel_m)
    return float(tone + grain + 0.5 * cover)


@jit
def blend(kind: int, x: float, y: float, z: float, softness: float) -> float:
    """Share 0..1 of the second colour at a point in units of a cell; ``softness`` is a pixel's
    width in cells.
    """
    if kind == WOOD:
        return wood(x, y, softness)
    if kind == STRIPES:
        return 0.5 + 0.5 * soft_square(x, softness)
    if kind == CHECKER:
        return 0.5 + 0.5 * soft_square(x, softness) * soft_square(y, softness) * soft_square(
            z, softness
        )
    if kind == NOISE:
        return max(0.0, min(1.0, 0.5 + 2.5 * (value_noise(x, y, z) - 0.5)))
    if kind == GRADIENT:
        return float(abs(x - 2.0 * np.floor(x * 0.5) - 1.0))
    return 0.0


@jit
def lights(world_T_obj_M44: Floats) -> Floats:
    """The direction to the lamp (row 0) and up (row 1) in every mesh's frame (M23)."""
    lights_M23 = np.empty((len(world_T_obj_M44), 2, 3))
    for mesh_i in range(len(world_T_obj_M44)):
        for axis in range(3):
            lights_M23[mesh_i, 0, axis] = 0.0
            for i in range(3):
                lights_M23[mesh_i, 0, axis] += world_T_obj_M44[mesh_i, i, axis] * TO_LAMP_3[i]
            lights_M23[mesh_i, 1, axis] = world_T_obj_M44[mesh_i, 2, axis]
    return lights_M23


@jit
def lit_points(
    depth_m_HW: Floats,
    face_HW: Ints,
    mesh_F: Ints,
    normal_F44: Floats,
    obj_T_cam_M44: Floats,
    lights_M23: Floats,
    K_33: Floats,
) -> Floats:
    """The point that every pixel sees, in its mesh's own frame, and how brightly it is lit (HW4: x,
    y, z, brightness).

    ``normal_F44`` are ``normals.normal_maps``, ``lights_M23`` those of ``lights``; the side that is
    seen is lit.
    """
    height, width = face_HW.shape
    lit_HW4 = np.empty((height, width, 4))
    T, N, L = obj_T_cam_M44, normal_F44, lights_M23
    rays_per_px, skew = 1.0 / K_33[0, 0], K_33[0, 1]
    for row in range(height):
        ray_y = (row + 0.5 - K_33[1, 2]) / K_33[1, 1]
        for column in range(width):
            f = face_HW[row, column]
            if f < 0:
                continue
            m, depth = mesh_F[f], depth_m_HW[row, column]
            x_cam, y_cam = (
                (column + 0.5 - K_33[0, 2] - skew * ray_y) * rays_per_px * depth,
                ray_y * depth,
            )
            way_x = T[m, 0, 0] * x_cam + T[m, 0, 1] * y_cam + T[m, 0, 2] * depth
            way_y = T[m, 1, 0] * x_cam + T[m, 1, 1] * y_cam + T[m, 1, 2] * depth
            way_z = T[m, 2, 0] * x_cam + T[m, 2, 1] * y_cam + T[m, 2, 2] * depth
            x, y, z = T[m, 0, 3] + way_x, T[m, 1, 3] + way_y, T[m, 2, 3] + way_z
            nx = N[f, 0, 0] * x + N[f, 0, 1] * y + N[f, 0, 2] * z + N[f, 0, 3]
            ny = N[f, 1, 0] * x + N[f, 1, 1] * y + N[f, 1, 2] * z + N[f, 1, 3]
            nz = N[f, 2, 0] * x + N[f, 2, 1] * y + N[f, 2, 2] * z + N[f, 2, 3]
            scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
            if way_x * N[f, 3, 0] + way_y * N[f, 3, 1] + way_z * N[f, 3, 2] > 0.0:
                scale = -scale
            lamp = (L[m, 0, 0] * nx + L[m, 0, 1] * ny + L[m, 0, 2] * nz) * scale
            up = (L[m, 1, 0] * nx + L[m, 1, 1] * ny + L[m, 1, 2] * nz) * scale
            lit_HW4[row, column, 0], lit_HW4[row, column, 1], lit_HW4[row, column, 2] = x, y, z
            lit_HW4[row, column, 3] = AMBIENT + SKY_LIGHT * up + LAMP_LIGHT * max(0.0, lamp)
    return lit_HW4


@jit
def colour(
    lit_HW4: Floats,
    depth_m_HW: Floats,
    face_HW: Ints,
    focal_px: float,
    mesh_F: Ints,
    kind_M: Ints,
    rgb_M23: Floats,
    cell_m_M: Floats,
    cell_T_obj_M34: Floats,
    rgb_HW3: NDArray[np.uint8],
) -> None:
    """Paint every pixel that sees a face (``face_HW`` >= 0) with its mesh's texture, as bright as
    it is lit.
    """
    T, C = cell_T_obj_M34, rgb_M23
    for row in range(face_HW.shape[0]):
        for column in range(face_HW.shape[1]):
            if face_HW[row, column] < 0:
                continue
            m = mesh_F[face_HW[row, column]]
            share = 0.0
            if kind_M[m] != PLAIN:
                x, y, z = lit_HW4[row, column, 0], lit_HW4[row, column, 1], lit_HW4[row, column, 2]
                share = blend(
                    kind_M[m],
                    T[m, 0, 0] * x + T[m, 0, 1] * y + T[m, 0, 2] * z + T[m, 0, 3],
                    T[m, 1, 0] * x + T[m, 1, 1] * y + T[m, 1, 2] * z + T[m, 1, 3],
                    T[m, 2, 0] * x + T[m, 2, 1] * y + T[m, 2, 2] * z + T[m, 2, 3],
                    depth_m_HW[row, column] / (focal_px * cell_m_M[m]),
                )
            bright = 255.0 * lit_HW4[row, column, 3]
            for i in range(3):
                value = (C[m, 0, i] + share * (C[m, 1, i] - C[m, 0, i])) * bright
                rgb_HW3[row, column, i] = int(min(255.0, value) + 0.5)


@jit
def sky(world_T_cam_44: Floats, K_33: Floats, height: int, width: int) -> NDArray[np.uint8]:
    """RGB (HW3) of what lies behind everything: paler towards the horizon."""
    rgb_HW3 = np.empty((height, width, 3), dtype=np.uint8)
    for row in range(height):
        ray_y = (row + 0.5 - K_33[1, 2]) / K_33[1, 1]
        for column in range(width):
            ray_x = (column + 0.5 - K_33[0, 2] - K_33[0, 1] * ray_y) / K_33[0, 0]
            up = world_T_cam_44[2, 0] * ray_x + world_T_cam_44[2, 1] * ray_y + world_T_cam_44[2, 2]
            share = max(0.0, min(1.0, 0.5 + 0.5 * up))
            for i in range(3):
                value = HORIZON_RGB_3[i] + share * (ZENITH_RGB_3[i] - HORIZON_RGB_3[i])
                rgb_HW3[row, column, i] = int(255.0 * value + 0.5)
    return rgb_HW3
