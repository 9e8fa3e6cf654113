"""Edits of a scenario before it is simulated (A.2).

Every edit changes the initial state given to Bullet and the perceived objects alike.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from oes.config import params
from oes.counterfactual.compose import PoseTable
from oes.episode import Body, Episode, Floats, Step
from oes.evaluation.forecasters import PerceivedScene
from oes.geom.se3 import rotation_z
from oes.geom.voxels import Grid, centers, sample
from oes.objects import Objects, map_tensors
from oes.perception.surface import scale_profiles

EDIT_TYPES = ("move", "resize", "remove", "add", "push")


@params
class EditsConfig:
    """Ranges of random edits.

    ``move_m``: distance of a moved object. ``add_m``: distance of a copy from its original.
    ``scale_factors``: sizes relative to the original. ``turn_deg``: turn of pushes, either way.
    ``gap_m``: free space around edited objects and rod. ``rim_m``: largest |x| and |y| of objects.
    ``max_attempts``: samples until an edit is feasible.
    """

    move_m: tuple[float, float]
    add_m: tuple[float, float]
    scale_factors: tuple[float, ...]
    turn_deg: tuple[float, float]
    gap_m: float
    rim_m: float
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
    true_i, first = scenario.scene.truth[i], scenario.episode.steps[0]
    world_T_obj_N44, center_N3 = first.world_T_obj_N44.copy(), first.center_N3.copy()
    if true_i >= 0:
        world_T_obj_N44[true_i, :3, 3] += shift_3
        center_N3[true_i] += shift_3
    shift = torch.from_numpy(shift_3).float()
    objects, poses = scenario.scene.objects, scenario.poses
    objects = replace(objects, center_N3=_row_added(objects.center_N3, i, shift))
    poses = replace(poses, translation_N3=_row_added(poses.translation_N3, i, shift))
    first = replace(first, world_T_obj_N44=world_T_obj_N44, center_N3=center_N3)
    return _edited(scenario, scenario.episode.bodies, first, objects, poses)


def resize_object(scenario: Scenario, i: int, factor: float, window: Grid) -> Scenario:
    """Scale the perceived object ``i`` and its true object about their base on the table."""
    true_i, first = scenario.scene.truth[i], scenario.episode.steps[0]
    base_3 = first.center_N3[true_i] * [1, 1, 0]
    world_T_obj_N44, center_N3 = first.world_T_obj_N44.copy(), first.center_N3.copy()
    for position_3 in (world_T_obj_N44[true_i, :3, 3], center_N3[true_i]):
        position_3[:] = base_3 + factor * (position_3 - base_3)
    size_N3 = first.size_N3.copy()
    size_N3[true_i] *= factor
    bodies = list(scenario.episode.bodies)
    bodies[true_i] = replace(bodies[true_i], scale_3=bodies[true_i].scale_3 * factor)
    first = replace(first, world_T_obj_N44=world_T_obj_N44, center_N3=center_N3, size_N3=size_N3)
    objects, up = _resized(scenario.scene.objects, i, factor, window)
    scale_N = scenario.poses.scale_N.clone()
    scale_N[i] *= factor
    translation_N3 = _row_added(scenario.poses.translation_N3, i, up)
    poses = replace(scenario.poses, translation_N3=translation_N3, scale_N=scale_N)
    return _edited(scenario, tuple(bodies), first, objects, poses)


def _resized(objects: Objects, i: int, factor: float, window: Grid) -> tuple[Objects, Tensor]:
    """Objects with one scaled about its base, and the shift of its centre."""
    up = torch.tensor([0, 0, float(objects.center_N3[i, 2]) * (factor - 1)])
    changed = map_tensors(objects, torch.clone)
    crop_CXYZ = objects.crop_NCXYZ[i]
    points_1P3 = (centers(window) / factor).reshape(1, -1, 3)
    crop_PC = sample(crop_CXYZ[None].float(), window, points_1P3)[0]
    changed.crop_NCXYZ[i] = crop_PC.T.reshape(crop_CXYZ.shape)
    changed.radial_profile_NRD3[i] = scale_profiles(objects.radial_profile_NRD3[i], factor)
    changed.size_N3[i] *= factor
    changed.com_offset_N3[i] *= factor
    changed.center_N3[i] += up
    return changed, up


def remove_object(scenario: Scenario, i: int) -> Scenario:
    """Remove the perceived object ``i`` and its true object."""
    scene, true_i = scenario.scene, scenario.scene.truth[i]
    left = [n for n in range(len(scene.truth)) if n != i]
    others = [n for n in range(len(scenario.episode.bodies)) if n != true_i]
    truth = [n - (n > true_i) for n in (scene.truth[k] for k in left)]
    return _selected(scenario, truth, left, others)


def add_object(scenario: Scenario, i: int, shift_3: Floats) -> Scenario:
    """Add a copy of the perceived object ``i`` and its true object at a displacement."""
    truth, count = scenario.scene.truth, len(scenario.episode.bodies)
    perceived, true = [*range(len(truth)), i], [*range(count), truth[i]]
    return move_object(_selected(scenario, [*truth, count], perceived, true), len(truth), shift_3)


def shift_rod(scenario: Scenario, shift_3: Floats) -> Scenario:
    """Start the rod elsewhere."""
    steps = scenario.episode.steps
    first = replace(steps[0], tip_world_3=steps[0].tip_world_3 + shift_3)
    return replace(scenario, episode=replace(scenario.episode, steps=(first, *steps[1:])))


def redirect_push(scenario: Scenario, turn_rad: float) -> Scenario:
    """Turn the actions about the vertical through the rod's start."""
    actions_T3 = scenario.episode.actions_T3 @ rotation_z(turn_rad).T
    return replace(scenario, episode=replace(scenario.episode, actions_T3=actions_T3))


def _row_added(values: Tensor, i: int, change: Tensor) -> Tensor:
    changed = values.clone()
    changed[i] += change
    return changed


def _selected(
    scenario: Scenario, truth: list[int], perceived: list[int], true: list[int]
) -> Scenario:
    """Keep the given perceived and true objects, in this order, some twice.

    ``truth`` are the new matches of the perceived objects.
    """
    scenario = replace(scenario, scene=replace(scenario.scene, truth=truth))
    objects = map_tensors(scenario.scene.objects, lambda x: x[perceived])
    poses = map_tensors(scenario.poses, lambda x: x[perceived])
    first = scenario.episode.steps[0]
    first = replace(
        first,
        world_T_obj_N44=first.world_T_obj_N44[true],
        center_N3=first.center_N3[true],
        size_N3=first.size_N3[true],
    )
    bodies = tuple(scenario.episode.bodies[n] for n in true)
    return _edited(scenario, bodies, first, objects, poses)


def _edited(
    scenario: Scenario, bodies: tuple[Body, ...], first: Step, objects: Objects, poses: PoseTable
) -> Scenario:
    steps = (first, *scenario.episode.steps[1:])
    episode = replace(scenario.episode, bodies=bodies, steps=steps)
    scene = replace(scenario.scene, objects=objects)
    return replace(scenario, episode=episode, scene=scene, poses=poses)


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
    """A random edit of perceived object ``i``, and the true object whose place must be free."""
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
    """Whether a true object's upright cylinder is clear of the others and the rod, on the table."""
    first = scenario.episode.steps[0]
    xy_N2, z_N = first.center_N3[:, :2], first.center_N3[:, 2]
    radius_N, half_height_N = (
        np.linalg.norm(first.size_N3[:, :2], axis=1) / 2,
        first.size_N3[:, 2] / 2,
    )
    lateral_N = np.linalg.norm(xy_N2 - xy_N2[true_i], axis=1) - radius_N - radius_N[true_i]
    vertical_N = np.abs(z_N - z_N[true_i]) - half_height_N - half_height_N[true_i]
    gap_N = np.maximum(lateral_N, vertical_N)
    gap_N[true_i] = np.inf
    to_rod = np.linalg.norm(first.tip_world_3[:2] - xy_N2[true_i]) - radius_N[true_i]
    # Without a robot the tip is NaN, and no comparison with it holds.
    is_clear = (gap_N > cfg.gap_m).all() and not to_rod < 2 * cfg.gap_m
    return bool(is_clear and (np.abs(xy_N2[true_i]) + radius_N[true_i] < cfg.rim_m).all())
