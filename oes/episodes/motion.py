"""Motion and contacts of the objects of a recorded episode."""

from itertools import combinations

import numpy as np

from oes.episode import FIRST_OBJECT, ROBOT, Episode, Floats
from oes.metrics import errors


def displacement_mm(episode: Episode, T: int) -> Floats:
    """Displacement N of each object's initial box centre, moved with the object, after T actions.

    The centre, unlike the mesh's origin, does not depend on where a mesh has its frame.
    """
    first, step = episode.steps[0], episode.steps[T]
    motion_N44 = step.world_T_obj_N44 @ np.linalg.inv(first.world_T_obj_N44)
    moved_N3 = (motion_N44[:, :3, :3] @ first.center_N3[..., None])[..., 0] + motion_N44[:, :3, 3]
    return errors.translation_mm(moved_N3, first.center_N3)


def object_rotation_deg(episode: Episode, T: int) -> Floats:
    """Angle N by which each object has rotated after T actions."""
    first, step = episode.steps[0], episode.steps[T]
    return errors.rotation_deg(step.world_T_obj_N44[:, :3, :3], first.world_T_obj_N44[:, :3, :3])


def impact_T(episode: Episode) -> int | None:
    """First T by which the last object, the falling one, touched anything; None if it never did."""
    return next((T for T, step in enumerate(episode.steps) if step.contact_AA[-1].any()), None)


def has_object_contact(episode: Episode) -> bool:
    """Whether two objects touched at any time."""
    return any(step.contact_AA[FIRST_OBJECT:, FIRST_OBJECT:].any() for step in episode.steps)


def contact_pairs(episode: Episode) -> list[tuple[int, int]]:
    """Pairs of bodies (rows of ``contact_AA``) that ever touched, other than with the table."""
    ever_AA = np.any([step.contact_AA for step in episode.steps], axis=0)
    return [(a, b) for a, b in combinations(range(ROBOT, len(ever_AA)), 2) if ever_AA[a, b]]
