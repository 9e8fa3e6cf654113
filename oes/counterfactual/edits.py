"""Edits of a scenario before it is simulated (A.2).

Every edit changes the initial state given to Bullet and the perceived objects alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from oes.config import params
from oes.counterfactual.compose import PoseTable
from oes.episode import Episode, Floats
from oes.evaluation.forecasters import PerceivedScene
from oes.geom.se3 import rotation_z
from oes.geom.voxels import Grid, centers, sample
from oes.objects import map_tensors
from oes.perception.surface import scale_profiles

EDIT_TYPES = ("move", "resize", "remove", "add", "push")


@params
class EditsConfig:
    """Ranges of random edits.

    ``move_m``: distance of a moved object. ``add_m``: distance of a copy from its original.
    ``scale_factors``: sizes relative to the original. ``turn_deg``: turn of pushes, either way.
    ``gap_m``: free space around edited objects and rod. ``table_edge_m``: their largest |x| and
    |y|. ``max_attempts``: samples until an edit is feasible.
    """

    move_m: tuple[float, float]
    add_m: tuple[float, float]
    scale_factors: tuple[float, ...]
    turn_deg: tuple[float, float]
    gap_m: float
    table_edge_m: float
    max_attempts: int


@dataclass(frozen=True)
class Scenario:
    """Initial state and actions of an episode, the perceived objects, and their poses to compose.

    The later states of ``episode`` are those of the unedited episode. ``label`` names the edit.
    """

    label: str
    episode: Episode
    scene: PerceivedScene
    poses: PoseTable


def move_object(scenario: Scenario, i: int, shift_3: Floats) -> Scenario:
    """Shift the perceived object ``i``, and the true object matched to it if any (metres)."""
    edited, true_i = _copied(scenario), scenario.scene.truth[i]
    if true_i >= 0:
        first = edited.episode.steps[0]
        first.world_T_obj_N44[true_i, :3, 3] += shift_3
        first.center_N3[true_i] += shift_3
    shift = torch.from_numpy(shift_3).float()
    edited.scene.objects.center_N3[i] += shift
    edited.poses.translation_N3[i] += shift
    return edited


def resize_object(scenario: Scenario, i: int, factor: float, window: Grid) -> Scenario:
    """Scale the perceived object ``i`` and its true object about their base on the table.

    ``window`` is the grid of the object crops.
    """
    edited, true_i = _copied(scenario), scenario.scene.truth[i]
    first, objects, poses = edited.episode.steps[0], edited.scene.objects, edited.poses
    base_3 = first.center_N3[true_i] * [1, 1, 0]
    for position_3 in (first.world_T_obj_N44[true_i, :3, 3], first.center_N3[true_i]):
        position_3[:] = base_3 + factor * (position_3 - base_3)
    first.size_N3[true_i] *= factor
    crop_CXYZ, profile_RD3 = objects.crop_NCXYZ[i], objects.radial_profile_NRD3[i]
    points_1P3 = (centers(window) / factor).reshape(1, -1, 3)
    crop_PC = sample(crop_CXYZ[None].float(), window, points_1P3)[0]
    crop_CXYZ[:] = crop_PC.T.reshape(crop_CXYZ.shape)
    profile_RD3[:] = scale_profiles(profile_RD3, factor)
    up = torch.tensor([0, 0, float(objects.center_N3[i, 2]) * (factor - 1)])
    for positions in (objects.center_N3, poses.translation_N3):
        positions[i] += up
    for lengths in (objects.size_N3, objects.com_offset_N3, poses.scale_N):
        lengths[i] *= factor
    bodies = list(scenario.episode.bodies)
    bodies[true_i] = replace(bodies[true_i], scale_3=bodies[true_i].scale_3 * factor)
    return replace(edited, episode=replace(edited.episode, bodies=tuple(bodies)))


def remove_object(scenario: Scenario, i: int) -> Scenario:
    """Remove the perceived object ``i`` and its true object."""
    truth, true_i = scenario.scene.truth, scenario.scene.truth[i]
    left = [n for n in range(len(truth)) if n != i]
    others = [n for n in range(len(scenario.episode.bodies)) if n != true_i]
    return _selected(scenario, [truth[n] - (truth[n] > true_i) for n in left], left, others)


def add_object(scenario: Scenario, i: int, shift_3: Floats) -> Scenario:
    """Add a copy of the perceived object ``i`` and its true object at a displacement."""
    truth, count = scenario.scene.truth, len(scenario.episode.bodies)
    perceived, true = [*range(len(truth)), i], [*range(count), truth[i]]
    return move_object(_selected(scenario, [*truth, count], perceived, true), len(truth), shift_3)


def shift_rod(scenario: Scenario, shift_3: Floats) -> Scenario:
    """Shift the initial position of the rod (metres)."""
    first, *later = scenario.episode.steps
    first = replace(first, tip_world_3=first.tip_world_3 + shift_3)
    return replace(scenario, episode=replace(scenario.episode, steps=(first, *later)))


def redirect_push(scenario: Scenario, turn_rad: float) -> Scenario:
    """Rotate all actions about the vertical."""
    actions_T3 = scenario.episode.actions_T3 @ rotation_z(turn_rad).T
    return replace(scenario, episode=replace(scenario.episode, actions_T3=actions_T3))


def _selected(
    scenario: Scenario, truth: Sequence[int], perceived: list[int], true: list[int]
) -> Scenario:
    """Copy with some of the perceived and true objects, in the given order.

    ``truth`` are the new matches of the perceived objects.
    """
    first, *later = scenario.episode.steps
    fields = ("world_T_obj_N44", "center_N3", "size_N3")
    first = replace(first, **{name: getattr(first, name)[true] for name in fields})
    bodies = tuple(scenario.episode.bodies[n] for n in true)
    episode = replace(scenario.episode, bodies=bodies, steps=(first, *later))
    objects = map_tensors(scenario.scene.objects, lambda x: x[perceived])
    poses = map_tensors(scenario.poses, lambda x: x[perceived])
    scene = replace(scenario.scene, objects=objects, truth=truth)
    return replace(scenario, episode=episode, scene=scene, poses=poses)


def _copied(scenario: Scenario) -> Scenario:
    """Copy whose initial state, objects and poses can be changed in place."""
    truth = scenario.scene.truth
    return _selected(scenario, truth, [*range(len(truth))], [*range(len(scenario.episode.bodies))])


def draw_edit(
    edit: str, scenario: Scenario, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> Scenario | None:
    """A random edit of one of ``EDIT_TYPES``, labelled; None if no attempt is feasible."""
    matched = [i for i, true_i in enumerate(scenario.scene.truth) if true_i >= 0]
    for _ in range(cfg.max_attempts if matched else 0):
        i = matched[int(rng.integers(len(matched)))]
        edited, true_i = _attempt(edit, scenario, i, cfg, window, rng)
        if edited is not None and (true_i is None or _is_free(edited, true_i, cfg)):
            return edited
    return None


def _attempt(
    edit: str, scenario: Scenario, i: int, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> tuple[Scenario | None, int | None]:
    """A random edit of perceived object ``i``, and the true object that must not collide."""
    true_i: int | None = scenario.scene.truth[i]
    if edit == "move":
        shift_3 = _shift(cfg.move_m, rng)
        edited = move_object(scenario, i, shift_3)
        label = f"one moved by {np.linalg.norm(shift_3) * 100:.0f} cm"
    elif edit == "resize":
        factor = float(rng.choice(cfg.scale_factors))
        edited, label = resize_object(scenario, i, factor, window), f"one {factor:g} times as large"
        true_i = None if factor < 1 else true_i
    elif edit == "remove":
        if len(scenario.episode.bodies) == 1:
            return None, None
        edited, label, true_i = remove_object(scenario, i), "one taken away", None
    elif edit == "add":
        shift_3, true_i = _shift(cfg.add_m, rng), len(scenario.episode.bodies)
        edited = add_object(scenario, i, shift_3)
        label = f"another, {np.linalg.norm(shift_3) * 100:.0f} cm away"
    else:
        turn_deg = float(rng.uniform(*cfg.turn_deg) * rng.choice([-1, 1]))
        edited, true_i = redirect_push(scenario, np.radians(turn_deg)), None
        side = "left" if turn_deg > 0 else "right"
        label = f"pushed {abs(turn_deg):.0f} degrees further {side}"
    return replace(edited, label=label), true_i


def _shift(distance_m: tuple[float, float], rng: np.random.Generator) -> Floats:
    angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(*distance_m)
    return distance * np.array([np.cos(angle), np.sin(angle), 0.0])


def _is_free(scenario: Scenario, true_i: int, cfg: EditsConfig) -> bool:
    """Whether the enclosing cylinder of a true object is on the table and clear of all others."""
    first = scenario.episode.steps[0]
    xy_N2, z_N = first.center_N3[:, :2], first.center_N3[:, 2]
    radius_N, height_N = np.linalg.norm(first.size_N3[:, :2], axis=1) / 2, first.size_N3[:, 2] / 2
    lateral_N = np.linalg.norm(xy_N2 - xy_N2[true_i], axis=1) - radius_N - radius_N[true_i]
    vertical_N = np.abs(z_N - z_N[true_i]) - height_N - height_N[true_i]
    gap_N = np.maximum(lateral_N, vertical_N)
    gap_N[true_i] = np.inf
    to_rod = np.linalg.norm(first.tip_world_3[:2] - xy_N2[true_i]) - radius_N[true_i]
    # Without a robot the tip is NaN, and no comparison with it holds.
    is_clear = (gap_N > cfg.gap_m).all() and not to_rod < 2 * cfg.gap_m
    return bool(is_clear and (np.abs(xy_N2[true_i]) + radius_N[true_i] < cfg.table_edge_m).all())
