"""Deferred shading: the colour of every pixel from the triangle it shows, and a sky behind.

Each step runs once a pixel over the rasteriser's images, so that hidden triangles cost nothing.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.jit import jit
from oes.render.raster import Geometry, Ints32, affine, linear

PLAIN, CHECKER, STRIPES, NOISE, GRADIENT, WOOD = 0, 1, 2, 3, 4, 5

TO_LIGHT_3 = np.array([0.42, -0.38, 0.82])
AMBIENT, SKY, DIFFUSE = 0.41, 0.11, 0.55  # everywhere; more from above than below; from the light
HORIZON_RGB_3, ZENITH_RGB_3 = np.array([0.90, 0.92, 0.94]), np.array([0.62, 0.70, 0.80])
LATTICE_SIZE = 4096
LATTICE = np.random.default_rng(0).random(LATTICE_SIZE)
PLANKS_PER_M, GRAINS_PER_M, GRAIN_ASPECT = 1 / 0.15, 1 / 0.012, 1 / 12
TABLE_GRID_M, LINE_M = 0.10, 0.003


class Textures(NamedTuple):
    """The textures of A bodies (``texture.Texture``)."""

    kind_A: NDArray[np.int64]
    rgb_A23: Floats
    cell_m_A: Floats
    cell_T_obj_A34: Floats


def light_directions(world_T_body_A44: Floats) -> Floats:
    """Directions to the light (row 0) and up (row 1) in every body's frame (A23)."""
    R_A33 = world_T_body_A44[:, :3, :3]
    # Elementwise, as a matrix product may fuse operations and its bits then vary by machine.
    to_light_A3 = (
        R_A33[:, 0] * TO_LIGHT_3[0] + R_A33[:, 1] * TO_LIGHT_3[1] + R_A33[:, 2] * TO_LIGHT_3[2]
    )
    return np.stack([to_light_A3, R_A33[:, 2]], axis=1)


@jit
def lit_points(
    depth_m_HW: Floats,
    face_HW: Ints32,
    geometry: Geometry,
    obj_T_cam_A44: Floats,
    lights_A23: Floats,
    K_33: Floats,
) -> Floats:
    """Point at every pixel in its body's frame, and its brightness (H W 4: x, y, z, brightness)."""
    height, width = face_HW.shape
    lit_HW4 = np.empty((height, width, 4))
    T, N, L = obj_T_cam_A44, geometry.normal_F44, lights_A23
    inv_focal, skew = 1.0 / K_33[0, 0], K_33[0, 1]
    for row in range(height):
        slope_y = (row + 0.5 - K_33[1, 2]) / K_33[1, 1]
        for column in range(width):
            f = face_HW[row, column]
            if f < 0:
                continue
            a, depth = geometry.body_F[f], depth_m_HW[row, column]
            slope_x = (column + 0.5 - K_33[0, 2] - skew * slope_y) * inv_focal
            ray_x, ray_y, ray_z = linear(T, a, slope_x * depth, slope_y * depth, depth)
            x, y, z = T[a, 0, 3] + ray_x, T[a, 1, 3] + ray_y, T[a, 2, 3] + ray_z
            nx, ny, nz = affine(N, f, x, y, z)
            # Normals have any length. The epsilon is for faces without area, whose normal is 0.
            scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
            # The face's own normal tells which side is seen; that side is lit.
            if ray_x * N[f, 3, 0] + ray_y * N[f, 3, 1] + ray_z * N[f, 3, 2] > 0.0:
                scale = -scale
            light = (L[a, 0, 0] * nx + L[a, 0, 1] * ny + L[a, 0, 2] * nz) * scale
            up = (L[a, 1, 0] * nx + L[a, 1, 1] * ny + L[a, 1, 2] * nz) * scale
            lit_HW4[row, column, 0], lit_HW4[row, column, 1], lit_HW4[row, column, 2] = x, y, z
            lit_HW4[row, column, 3] = AMBIENT + SKY * up + DIFFUSE * max(0.0, light)
    return lit_HW4


@jit
def paint(
    lit_HW4: Floats,
    depth_m_HW: Floats,
    face_HW: Ints32,
    geometry: Geometry,
    textures: Textures,
    focal_px: float,
    rgb_HW3: NDArray[np.uint8],
) -> None:
    """Write the texture's colour times the brightness at every pixel that shows a face."""
    kind_A, C = textures.kind_A, textures.rgb_A23
    for row in range(face_HW.shape[0]):
        for column in range(face_HW.shape[1]):
            if face_HW[row, column] < 0:
                continue
            a = geometry.body_F[face_HW[row, column]]
            share = 0.0
            if kind_A[a] != PLAIN:
                x, y, z = lit_HW4[row, column, 0], lit_HW4[row, column, 1], lit_HW4[row, column, 2]
                x, y, z = affine(textures.cell_T_obj_A34, a, x, y, z)
                # Edges are softened over a pixel's width there: less aliasing, one sample a pixel.
                pixel_cells = depth_m_HW[row, column] / (focal_px * textures.cell_m_A[a])
                share = blend(kind_A[a], x, y, z, pixel_cells)
            bright = 255.0 * lit_HW4[row, column, 3]
            for i in range(3):
                value = (C[a, 0, i] + share * (C[a, 1, i] - C[a, 0, i])) * bright
                rgb_HW3[row, column, i] = int(min(255.0, value) + 0.5)


@jit
def sky(world_T_cam_44: Floats, K_33: Floats, size_px: tuple[int, int]) -> NDArray[np.uint8]:
    """RGB (H W 3) of the background: paler towards the horizon."""
    rgb_HW3 = np.empty((*size_px, 3), dtype=np.uint8)
    for row in range(size_px[0]):
        ray_y = (row + 0.5 - K_33[1, 2]) / K_33[1, 1]
        for column in range(size_px[1]):
            ray_x = (column + 0.5 - K_33[0, 2] - K_33[0, 1] * ray_y) / K_33[0, 0]
            up = world_T_cam_44[2, 0] * ray_x + world_T_cam_44[2, 1] * ray_y + world_T_cam_44[2, 2]
            share = max(0.0, min(1.0, 0.5 + 0.5 * up))
            for i in range(3):
                value = HORIZON_RGB_3[i] + share * (ZENITH_RGB_3[i] - HORIZON_RGB_3[i])
                rgb_HW3[row, column, i] = int(255.0 * value + 0.5)
    return rgb_HW3


@jit
def blend(kind: int, x: float, y: float, z: float, pixel_cells: float) -> float:
    """Share 0..1 of the second colour at a point in units of a cell; a pixel's width in cells."""
    if kind == WOOD:
        return wood(x, y, pixel_cells)
    if kind == STRIPES:
        return 0.5 + 0.5 * square_wave(x, pixel_cells)
    if kind == CHECKER:
        xy = square_wave(x, pixel_cells) * square_wave(y, pixel_cells)
        return 0.5 + 0.5 * xy * square_wave(z, pixel_cells)
    if kind == NOISE:
        return max(0.0, min(1.0, 0.5 + 2.5 * (value_noise(x, y, z) - 0.5)))
    if kind == GRADIENT:
        return float(abs(x - 2.0 * np.floor(x * 0.5) - 1.0))
    return 0.0


@jit
def square_wave(x: float, edge_width: float) -> float:
    """A square wave of period 2 between -1 and 1 with linear edges."""
    phase = x - 2.0 * np.floor(x * 0.5)
    edge = 0.5 - abs(phase - 1.0)  # distance to the nearest edge, negative in the other half
    return float(max(-1.0, min(1.0, 2.0 * edge / edge_width)))


@jit
def wood(x: float, y: float, pixel_m: float) -> float:
    """The table: planks along x with a faint grain, and a thin grid every ``TABLE_GRID_M``."""
    plank = int(np.floor(y * PLANKS_PER_M))
    tone = 0.35 * lattice_value(plank, 7, 7)
    grain = 0.35 * plane_noise(x * (GRAINS_PER_M * GRAIN_ASPECT), y * GRAINS_PER_M, plank)
    u, v = x * (1 / TABLE_GRID_M), y * (1 / TABLE_GRID_M)
    to_line = min(abs(u - np.floor(u + 0.5)), abs(v - np.floor(v + 0.5))) * TABLE_GRID_M
    if to_line > LINE_M + 0.5 * pixel_m:
        return float(tone + grain)
    # Lines thinner than a pixel fade instead of flickering.
    cover = min(1.0, 0.5 + (LINE_M - to_line) / pixel_m) * min(1.0, 2 * LINE_M / pixel_m)
    return float(tone + grain + 0.5 * cover)


@jit
def value_noise(x: float, y: float, z: float) -> float:
    """Smooth noise in 0..1 over space."""
    k = int(np.floor(z))
    w = z - k
    w = w * w * (3 - 2 * w)
    return plane_noise(x, y, k) * (1 - w) + plane_noise(x, y, k + 1) * w


@jit
def plane_noise(x: float, y: float, z: int) -> float:
    """Smooth noise in 0..1 over x and y, another for every z."""
    i, j = int(np.floor(x)), int(np.floor(y))
    u, v = x - i, y - j
    u, v = u * u * (3 - 2 * u), v * v * (3 - 2 * v)  # smoothstep hides the lattice
    front = lattice_value(i, j, z) * (1 - u) + lattice_value(i + 1, j, z) * u
    back = lattice_value(i, j + 1, z) * (1 - u) + lattice_value(i + 1, j + 1, z) * u
    return front * (1 - v) + back * v


@jit
def lattice_value(x: int, y: int, z: int) -> float:
    """A fixed pseudo-random number in 0..1 at a lattice point (hash of Teschner et al. 2003)."""
    return float(LATTICE[((x * 73856093) ^ (y * 19349663) ^ (z * 83492791)) & (LATTICE_SIZE - 1)])
