"""Solids with their convex parts, from which meshes are generated; z up, in any unit."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from oes.episode import Floats


@dataclass(frozen=True)
class Shape:
    """A closed surface and the convex parts that fill it."""

    solid: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]

    def moved(self, offset_3: ArrayLike) -> "Shape":
        """The shape translated by ``offset_3``."""
        matrix_44 = np.eye(4)
        matrix_44[:3, 3] = offset_3
        return self.mapped(matrix_44)

    def mapped(self, matrix_44: Floats) -> "Shape":
        """The shape under an affine map that keeps orientation."""
        meshes = [mesh.copy().apply_transform(matrix_44) for mesh in (self.solid, *self.parts)]
        return Shape(meshes[0], tuple(meshes[1:]))

    def turned(self, axis: str) -> "Shape":
        """The shape under the rotation of +z to +x or +y."""
        columns = {"x": [[0, 0, 1], [1, 0, 0], [0, 1, 0]], "y": [[-1, 0, 0], [0, 0, 1], [0, 1, 0]]}
        matrix_44 = np.eye(4)
        matrix_44[:3, :3] = columns[axis]
        return self.mapped(matrix_44)

    def cut(self, tool: "Shape") -> "Shape":
        """The solid minus ``tool``; the parts stay, so it must be a shallow recess."""
        solid = trimesh.boolean.difference([self.solid, tool.solid], engine="manifold")
        return Shape(solid, self.parts)


def join(*shapes: Shape) -> Shape:
    """One solid of several overlapping shapes."""
    solid = trimesh.boolean.union([shape.solid for shape in shapes], engine="manifold")
    return Shape(solid, tuple(part for shape in shapes for part in shape.parts))


def convex_hull(points_P3: ArrayLike) -> Shape:
    """The convex hull of a cloud of points."""
    solid = trimesh.convex.convex_hull(np.asarray(points_P3, float))
    return Shape(solid, (solid,))


def block(size_3: Sequence[float], center_3: ArrayLike, bevel: float) -> Shape:
    """A box with bevelled edges."""
    half_3 = np.asarray(size_3, float) / 2
    signs_83 = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    inset_333 = np.stack([half_3 - bevel * (np.arange(3) != axis) for axis in range(3)])
    corners_P3 = np.concatenate([signs_83 * inset_3 for inset_3 in inset_333])
    return convex_hull(corners_P3 + np.asarray(center_3))


def ring(radius: float, z: float, num_sections: int) -> Floats:
    """Points of a horizontal circle about the z axis."""
    return np.insert(radius * circle(num_sections), 2, z, axis=1)


def circle(num_sections: int) -> Floats:
    """Unit vectors D2, counter-clockwise from +x."""
    angle_D = np.arange(num_sections) * (2 * np.pi / num_sections)
    return np.stack([np.cos(angle_D), np.sin(angle_D)], 1)


def superellipse(num_sections: int, exponent: float, aspect: float) -> Floats:
    """Outline D2 of |x|^n + |y / aspect|^n = 1: a circle at n = 2, a rounded square above."""
    unit_D2 = circle(num_sections)
    radius_D = (np.abs(unit_D2) ** exponent).sum(1) ** (-1 / exponent)
    return np.asarray(unit_D2 * radius_D[:, None] * np.array([1.0, aspect]))


def frustum(radius_low: float, radius_high: float, height: float, num_sections: int) -> Shape:
    """A truncated cone standing on z = 0."""
    low, high = ring(radius_low, 0, num_sections), ring(radius_high, height, num_sections)
    return convex_hull(np.concatenate([low, high]))


def slab(outline_P2: ArrayLike, depth: float) -> Shape:
    """A convex outline in (x, z), as thick as ``depth`` along y, centred on y = 0."""
    xz_P2 = np.asarray(outline_P2, float)
    sides = [np.insert(xz_P2, 1, y, axis=1) for y in (-depth / 2, depth / 2)]
    return convex_hull(np.concatenate(sides))


def shell(rings_RD3: Floats) -> trimesh.Trimesh:
    """The closed surface through R rings of D points, with a fan over the first and the last."""
    count, sections, _ = rings_RD3.shape
    vertices = np.concatenate([rings_RD3.reshape(-1, 3), rings_RD3[[0, -1]].mean(1)])
    here = np.arange(sections)
    after = np.roll(here, -1)
    faces = [np.stack([after, here, np.full(sections, count * sections)], 1)]
    for low in range(0, (count - 1) * sections, sections):
        high = low + sections
        lower = np.stack([low + here, low + after, high + after], 1)
        faces += [lower, np.stack([low + here, high + after, high + here], 1)]
    last = (count - 1) * sections
    faces.append(np.stack([last + here, last + after, np.full(sections, count * sections + 1)], 1))
    mesh = trimesh.Trimesh(vertices, np.concatenate(faces), process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def vessel(
    outer_R2: Floats, inner_R2: Floats, outline_D2: Floats, num_bands: int, num_sectors: int
) -> Shape:
    """An open vessel: profiles of (radius, z) from the foot to the lip, times an outline.

    Its parts are a floor and ``num_bands`` x ``num_sectors`` wedges of wall. The number of outline
    points is a multiple of ``num_sectors``.
    """

    def rings(profile_R2: Floats) -> Floats:
        flat = profile_R2[:, None, :1] * outline_D2
        z = np.broadcast_to(profile_R2[:, None, 1:], (*flat.shape[:2], 1))
        return np.concatenate([flat, z], 2)

    outer, inner = rings(outer_R2), rings(inner_R2)
    parts = [*convex_hull(np.concatenate([outer[0], inner[0]])).parts]
    edges = np.linspace(0, len(outer) - 1, num_bands + 1).round().astype(int)
    width = outline_D2.shape[0] // num_sectors
    for low, high in pairwise(edges):
        for start in range(0, num_sectors * width, width):
            columns = np.arange(start, start + width + 1) % outline_D2.shape[0]
            wall = [side[low : high + 1][:, columns].reshape(-1, 3) for side in (outer, inner)]
            parts += convex_hull(np.concatenate(wall)).parts
    return Shape(shell(np.concatenate([outer, inner[::-1]])), tuple(parts))


def tube(
    path_P3: Floats, half_width: float, half_thickness: float, num_sections: int, links: int
) -> Shape:
    """An ellipse, ``half_width`` along y, swept along a path in the xz plane in ``links`` parts."""
    tangent_P3 = np.gradient(path_P3, axis=0)
    tangent_P3 /= np.linalg.norm(tangent_P3, axis=1, keepdims=True)
    normal_P3 = np.cross(np.array([0.0, 1.0, 0.0]), tangent_P3)
    across_D, along_D = circle(num_sections).T
    offset = half_thickness * across_D[:, None] * normal_P3[:, None]
    rings = path_P3[:, None] + offset + half_width * along_D[:, None] * np.array([0.0, 1.0, 0.0])
    edges = np.linspace(0, len(rings) - 1, links + 1).round().astype(int)
    parts = [convex_hull(rings[a : b + 1].reshape(-1, 3)).solid for a, b in pairwise(edges)]
    return Shape(shell(rings), tuple(parts))
