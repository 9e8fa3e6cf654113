"""Placement of a new mesh in its obj frame: at rest, scaled, origin at its box centre."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from oes.config import params
from oes.episode import Floats
from oes.meshes.convex import Mass, fill, solid_mass

MIN_TURN_DEG = 0.5  # smaller turns would only add rounding errors


@params
class StandConfig:
    """Limits on a mesh: longest over shortest side, and rotation to a stable pose."""

    max_aspect: float
    max_tilt_deg: float


class MeshRejected(ValueError):
    """An unusable mesh; the message is the reason."""


@dataclass(frozen=True)
class Draft:
    """A mesh of any size, z up, with its convex parts. ``status``: its repairs, in words."""

    id: str
    category: str
    source: str
    status: str
    visual: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]

    def mapped(self, matrix_44: Floats) -> "Draft":
        """The draft under a similarity transform."""
        meshes = (self.visual, *self.parts)
        visual, *parts = [mesh.copy().apply_transform(matrix_44) for mesh in meshes]
        return replace(self, visual=visual, parts=tuple(parts))


def placed(draft: Draft, longest_m: float, cfg: StandConfig) -> tuple[Draft, Mass]:
    """The draft in its obj frame with its longest horizontal side ``longest_m``, and its mass.

    Raises MeshRejected if it has no volume, is too thin or would tip over.
    """
    mass = draft_mass(draft)
    if mass.volume_m3 < 1e-4 * float(np.prod(draft.visual.extents)):
        raise MeshRejected("encloses no volume")
    rest_44, tilt_deg = resting(draft.visual.convex_hull, mass.com_obj_3)
    if tilt_deg > cfg.max_tilt_deg:
        limit = f"at most {cfg.max_tilt_deg:g}"
        raise MeshRejected(
            f"tips over: the nearest stable pose is {tilt_deg:.0f} deg away, {limit}"
        )
    draft = draft.mapped(rest_44)
    extents_3 = draft.visual.extents
    aspect = extents_3.max() / extents_3.min()
    if aspect > cfg.max_aspect * (1 + 1e-6):
        raise MeshRejected(f"sides {aspect:.1f} to 1, at most {cfg.max_aspect:g}")
    scale = longest_m / extents_3[:2].max()
    matrix_44 = np.diag([scale, scale, scale, 1.0])
    matrix_44[:3, 3] = -scale * draft.visual.bounds.mean(0)
    draft = draft.mapped(matrix_44)
    return draft, draft_mass(draft)


def draft_mass(draft: Draft) -> Mass:
    """Mass of the visual surface if it bounds a plausible solid, else of the union of its parts."""
    # Nested or doubled surfaces hold more than the parts do, inside-out ones far less.
    parts_m3 = sum(part.volume for part in draft.parts)
    if draft.visual.is_volume and 0.2 * parts_m3 < draft.visual.volume < 1.05 * parts_m3:
        return solid_mass(draft.visual)
    return solid_mass(fill(draft.parts))


def resting(hull: trimesh.Trimesh, com_3: Floats) -> tuple[Floats, float]:
    """Smallest rotation (4x4) that puts a convex hull on a stable facet, and its angle (deg).

    A facet is stable if the projection of the centre of mass onto its plane lies inside it.
    """
    corner_F33 = hull.triangles
    normal_F3 = hull.face_normals
    projection_F3 = (
        com_3 - ((com_3 - corner_F33[:, 0]) * normal_F3).sum(1, keepdims=True) * normal_F3
    )
    weights_F3 = trimesh.triangles.points_to_barycentric(corner_F33, projection_F3)
    stable_F = (weights_F3 > -1e-6).all(1)
    tilt_F = np.where(stable_F, np.degrees(np.arccos(np.clip(-normal_F3[:, 2], -1, 1))), np.inf)
    facet_i = int(tilt_F.argmin())
    if tilt_F[facet_i] < MIN_TURN_DEG:
        return np.eye(4), 0.0
    rotation_44 = trimesh.geometry.align_vectors(normal_F3[facet_i], [0, 0, -1])
    return np.asarray(rotation_44), float(tilt_F[facet_i])
