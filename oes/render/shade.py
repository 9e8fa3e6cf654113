"""Deferred shading: the colour of every pixel from the triangle it sees, compiled; background where it sees none."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oes.episode import Floats
from oes.render.compiled import compiled
from oes.render.raster import Ints

PLAIN, CHECKER, STRIPES, NOISE, GRADIENT, WOOD = 0, 1, 2, 3, 4, 5

TO_LIGHT_3 = np.array([0.42, -0.38, 0.82])
AMBIENT_SKY, AMBIENT_GROUND, DIFFUSE = 0.52, 0.30, 0.55
HORIZON_RGB_3, ZENITH_RGB_3 = np.array([0.90, 0.92, 0.94]), np.array([0.62, 0.70, 0.80])
PLANK_M, GRID_M, LINE_M, GRAIN_M = 0.15, 0.10, 0.003, 0.012


class Paint(NamedTuple):
    """How M meshes and their F faces are coloured (see ``texture.Texture``, ``normals.normal_maps``)."""

    mesh_F: Ints
    normal_T_obj_F34: Floats
    kind_M: Ints
    rgb_M23: Floats
    cell_m_M: Floats
    cell_T_obj_M34: Floats


@compiled
def lattice_value(x: int, y: int, z: int) -> float:
    """A fixed pseudo-random number in 0..1 at a lattice point."""
    h = np.uint32(x) * np.uint32(0x8DA6B343) ^ np.uint32(y) * np.uint32(0xD8163841) ^ np.uint32(z) * np.uint32(0xCB1AB31F)
    h = np.uint32((h ^ (h >> np.uint32(13))) * np.uint32(0x5BD1E995))
    return float((h ^ (h >> np.uint32(15))) & np.uint32(0xFFFF)) / 65535.0


@compiled
def value_noise(x: float, y: float, z: float) -> float:
    """Smooth noise in 0..1: lattice values blended by smoothstep."""
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    u, v, w = x - i, y - j, z - k
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for corner in range(8):
        right, back, up = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (u if right else 1 - u) * (v if back else 1 - v) * (w if up else 1 - w)
        total += weight * lattice_value(i + right, j + back, k + up)
    return total


@compiled
def soft_square(x: float, softness: float) -> float:
    """A square wave of period 2 between -1 and 1 whose edges are ``softness`` wide."""
    phase = x - 2.0 * np.floor(x * 0.5)
    edge = 0.5 - abs(phase - 1.0)  # distance to the nearest edge, negative in the other half
    return max(-1.0, min(1.0, 2.0 * edge / softness))


@compiled
def blend(kind: int, x: float, y: float, z: float, softness: float) -> float:
    """Share 0..1 of the second colour at a point in units of a cell; ``softness`` is a pixel's width in cells."""
    if kind == CHECKER:
        product = soft_square(x, softness) * soft_square(y, softness) * soft_square(z, softness)
        return 0.5 + 0.5 * product
    if kind == STRIPES:
        return 0.5 + 0.5 * soft_square(x, softness)
    if kind == NOISE:
        return max(0.0, min(1.0, 0.5 + 2.5 * (value_noise(x, y, z) - 0.5)))
    if kind == GRADIENT:
        return max(0.0, min(1.0, 0.5 + 0.5 * (x - 0.5)))
    if kind == WOOD:
        return wood(x, y, softness)
    return 0.0


@compiled
def wood(x: float, y: float, pixel_m: float) -> float:
    """The table: planks along x with a faint grain, and a thin grid every ``GRID_M``."""
    plank = np.floor(y / PLANK_M)
    tone = 0.35 * lattice_value(int(plank), 7, 7)
    grain = 0.35 * value_noise(x / (12 * GRAIN_M), y / GRAIN_M, plank)
    to_line = min(abs(x / GRID_M - np.floor(x / GRID_M + 0.5)), abs(y / GRID_M - np.floor(y / GRID_M + 0.5))) * GRID_M
    line = 0.5 * max(0.0, min(1.0, 0.5 + (LINE_M - to_line) / pixel_m)) * min(1.0, 2 * LINE_M / pixel_m)
    return tone + grain + line


@compiled
def light(normal_x: float, normal_y: float, normal_z: float) -> float:
    """Brightness of a surface by its unit normal in world: sky and ground ambient, and one lamp."""
    cosine = normal_x * TO_LIGHT_3[0] + normal_y * TO_LIGHT_3[1] + normal_z * TO_LIGHT_3[2]
    ambient = AMBIENT_GROUND + (AMBIENT_SKY - AMBIENT_GROUND) * (0.5 + 0.5 * normal_z)
    return ambient + DIFFUSE * max(0.0, cosine)


@compiled
def shade(
    nearness_HW: Floats, face_HW: Ints, obj_T_cam_M44: Floats, world_T_cam_44: Floats, K_33: Floats, paint: Paint
) -> NDArray[np.uint8]:
    """RGB (HW3) of every pixel, given its 1/z and triangle as ``raster.rasterise`` leaves them."""
    height, width = face_HW.shape
    rgb_HW3 = np.empty((height, width, 3), dtype=np.uint8)
    C = world_T_cam_44
    for row in range(height):
        for column in range(width):
            ray_y = (row + 0.5 - K_33[1, 2]) / K_33[1, 1]
            ray_x = (column + 0.5 - K_33[0, 2] - K_33[0, 1] * ray_y) / K_33[0, 0]
            face_i = face_HW[row, column]
            if face_i < 0:
                up = C[2, 0] * ray_x + C[2, 1] * ray_y + C[2, 2]
                share = max(0.0, min(1.0, 0.5 + 0.5 * up / np.sqrt(ray_x * ray_x + ray_y * ray_y + 1.0)))
                for i in range(3):
                    rgb_HW3[row, column, i] = int(
                        255.0 * (HORIZON_RGB_3[i] + share * (ZENITH_RGB_3[i] - HORIZON_RGB_3[i])) + 0.5
                    )
                continue
            z = 1.0 / nearness_HW[row, column]
            mesh_i = paint.mesh_F[face_i]
            x, y, z_obj = moved(obj_T_cam_M44[mesh_i], ray_x * z, ray_y * z, z)
            nx, ny, nz = moved(paint.normal_T_obj_F34[face_i], x, y, z_obj)
            # obj_R_cam transposed takes the normal to cam, where it must point against the ray
            T = obj_T_cam_M44[mesh_i]
            cam_x = T[0, 0] * nx + T[1, 0] * ny + T[2, 0] * nz
            cam_y = T[0, 1] * nx + T[1, 1] * ny + T[2, 1] * nz
            cam_z = T[0, 2] * nx + T[1, 2] * ny + T[2, 2] * nz
            scale = 1.0 / np.sqrt(nx * nx + ny * ny + nz * nz + 1e-30)
            if cam_x * ray_x + cam_y * ray_y + cam_z > 0.0:
                scale = -scale
            brightness = light(
                (C[0, 0] * cam_x + C[0, 1] * cam_y + C[0, 2] * cam_z) * scale,
                (C[1, 0] * cam_x + C[1, 1] * cam_y + C[1, 2] * cam_z) * scale,
                (C[2, 0] * cam_x + C[2, 1] * cam_y + C[2, 2] * cam_z) * scale,
            )
            share = 0.0
            if paint.kind_M[mesh_i] != PLAIN:
                u, v, w = moved(paint.cell_T_obj_M34[mesh_i], x, y, z_obj)
                share = blend(paint.kind_M[mesh_i], u, v, w, z / (K_33[0, 0] * paint.cell_m_M[mesh_i]))
            colours = paint.rgb_M23[mesh_i]
            for i in range(3):
                value = (colours[0, i] + share * (colours[1, i] - colours[0, i])) * brightness
                rgb_HW3[row, column, i] = int(255.0 * min(1.0, value) + 0.5)
    return rgb_HW3


@compiled
def moved(T_34: Floats, x: float, y: float, z: float) -> tuple[float, float, float]:
    """A point under a 3x4 affine map."""
    return (
        T_34[0, 0] * x + T_34[0, 1] * y + T_34[0, 2] * z + T_34[0, 3],
        T_34[1, 0] * x + T_34[1, 1] * y + T_34[1, 2] * z + T_34[1, 3],
        T_34[2, 0] * x + T_34[2, 1] * y + T_34[2, 2] * z + T_34[2, 3],
    )
