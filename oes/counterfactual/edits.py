"""What if: a scene changed before it is simulated, alike in what Bullet is told and in what was
perceived (A.2).
"""

from collections.abc import Callable
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
from oes.objects import Objects
from oes.perception.surface import scale_profiles


@params
class EditsConfig:
    """How far an object is moved, and a copy of it put; its new sizes over the old; by how much
    pushes are turned (to either side); and what must stay free: ``gap_m`` around objects and rod,
    all beyond ``rim_m`` of the middle.
    """

    move_m: tuple[float, float]
    add_m: tuple[float, float]
    factors: tuple[float, ...]
    turn_deg: tuple[float, float]
    gap_m: float
    rim_m: float
    attempts: int


@dataclass(frozen=True)
class Scenario:
    """A question: the start and actions of an episode (its later states are not true of it), what
    was perceived, and how the perceived objects are drawn at first.
    """

    words: str
    episode: Episode
    scene: PerceivedScene
    poses: PoseTable


def move_object(case: Scenario, i: int, shift_3: Floats) -> Scenario:
    """The perceived object ``i`` stands elsewhere, and so does the true one that it was matched to,
    if any.
    """
    true_i, first = case.scene.truth[i], case.episode.steps[0]
    world_T_obj_N44, center_N3 = first.world_T_obj_N44.copy(), first.center_N3.copy()
    if true_i >= 0:
        world_T_obj_N44[true_i, :3, 3] += shift_3
        center_N3[true_i] += shift_3
    shift = torch.from_numpy(shift_3).float()
    objects, poses = case.scene.objects, case.poses
    objects = replace(objects, center_N3=_added(objects.center_N3, i, shift))
    poses = replace(poses, translation_M3=_added(poses.translation_M3, i, shift))
    first = replace(first, world_T_obj_N44=world_T_obj_N44, center_N3=center_N3)
    return _changed(case, case.episode.bodies, first, objects, poses)


def resize_object(case: Scenario, i: int, factor: float, window: Grid) -> Scenario:
    """The perceived object ``i``, matched to a true one, is larger or smaller by a factor, on the
    same spot.
    """
    true_i, first = case.scene.truth[i], case.episode.steps[0]
    spot_3 = first.center_N3[true_i] * [1, 1, 0]
    world_T_obj_N44, center_N3, size_N3 = (
        x.copy() for x in (first.world_T_obj_N44, first.center_N3, first.size_N3)
    )
    for place_3 in (world_T_obj_N44[true_i, :3, 3], center_N3[true_i]):
        place_3[:] = spot_3 + factor * (place_3 - spot_3)
    size_N3[true_i] *= factor
    bodies = list(case.episode.bodies)
    bodies[true_i] = replace(bodies[true_i], scale_3=bodies[true_i].scale_3 * factor)
    objects, poses = case.scene.objects, case.poses
    up = torch.tensor([0, 0, float(objects.center_N3[i, 2]) * (factor - 1)])
    changed = {name: value.clone() for name, value in vars(objects).items()}
    points = (centers(window) / factor).reshape(1, -1, 3)
    crop_CXYZ = changed["crop_NCXYZ"][i]
    changed["crop_NCXYZ"][i] = sample(crop_CXYZ[None].float(), window, points)[0].T.reshape(
        crop_CXYZ.shape
    )
    changed["radial_profile_NRD3"][i] = scale_profiles(objects.radial_profile_NRD3[i], factor)
    for name in ("size_N3", "com_offset_N3"):
        changed[name][i] *= factor
    changed["center_N3"][i] += up
    objects = Objects(**changed)
    scale_M = poses.scale_M.clone()
    scale_M[i] *= factor
    poses = replace(poses, translation_M3=_added(poses.translation_M3, i, up), scale_M=scale_M)
    first = replace(first, world_T_obj_N44=world_T_obj_N44, center_N3=center_N3, size_N3=size_N3)
    return _changed(case, tuple(bodies), first, objects, poses)


def remove_object(case: Scenario, i: int) -> Scenario:
    """The perceived object ``i``, matched to a true one, is not there."""
    true_i = case.scene.truth[i]
    left = [n for n in range(len(case.scene.truth)) if n != i]
    others = [n for n in range(len(case.episode.bodies)) if n != true_i]
    truth = [n - (n > true_i) for n in (case.scene.truth[k] for k in left)]
    return _chosen(replace(case, scene=replace(case.scene, truth=truth)), left, others)


def add_object(case: Scenario, i: int, shift_3: Floats) -> Scenario:
    """A second object like the perceived ``i``, matched to a true one, stands at a displacement
    from it.
    """
    count, found = len(case.episode.bodies), len(case.scene.truth)
    scene = replace(case.scene, truth=[*case.scene.truth, count])
    twice = _chosen(
        replace(case, scene=scene), [*range(found), i], [*range(count), case.scene.truth[i]]
    )
    return move_object(twice, found, shift_3)


def restart_scene(case: Scenario, shift_3: Floats) -> Scenario:
    """The rod starts elsewhere."""
    first = case.episode.steps[0]
    first = replace(first, tip_world_3=first.tip_world_3 + shift_3)
    return replace(case, episode=replace(case.episode, steps=(first, *case.episode.steps[1:])))


def redirect_push(case: Scenario, turn_rad: float) -> Scenario:
    """The rod starts where it did and goes another way, turned about the vertical."""
    return replace(
        case,
        episode=replace(case.episode, actions_T3=case.episode.actions_T3 @ rotation_z(turn_rad).T),
    )


def _added(values: Tensor, i: int, change: Tensor) -> Tensor:
    """The same values, but for one row."""
    changed = values.clone()
    changed[i] += change
    return changed


def _chosen(case: Scenario, perceived: list[int], true: list[int]) -> Scenario:
    """Some of the perceived and of the true objects, in this order, some more than once."""
    objects = Objects(
        **{name: value[perceived] for name, value in vars(case.scene.objects).items()}
    )
    poses = PoseTable(**{name: value[perceived] for name, value in vars(case.poses).items()})
    first = case.episode.steps[0]
    first = replace(
        first,
        world_T_obj_N44=first.world_T_obj_N44[true],
        center_N3=first.center_N3[true],
        size_N3=first.size_N3[true],
    )
    return _changed(case, tuple(case.episode.bodies[n] for n in true), first, objects, poses)


def _changed(
    case: Scenario, bodies: tuple[Body, ...], first: Step, objects: Objects, poses: PoseTable
) -> Scenario:
    """With another first state."""
    episode = replace(case.episode, bodies=bodies, steps=(first, *case.episode.steps[1:]))
    return replace(case, episode=episode, scene=replace(case.scene, objects=objects), poses=poses)


def draw_edit(
    kind: str, case: Scenario, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> Scenario | None:
    """A random change of a kind (see ``EDIT_SAMPLERS``), told in words; None where no place was
    found for it.
    """
    known = [i for i, true_i in enumerate(case.scene.truth) if true_i >= 0]
    for _ in range(cfg.attempts if known else 0):
        found = EDIT_SAMPLERS[kind](case, known[int(rng.integers(len(known)))], cfg, window, rng)
        if found is not None:
            return found
    return None


EditSampler = Callable[[Scenario, int, EditsConfig, Grid, np.random.Generator], Scenario | None]


def _move(
    case: Scenario, i: int, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> Scenario | None:
    shift_3 = _shift(cfg.move_m, rng)
    found = replace(
        move_object(case, i, shift_3), words=f"one moved by {np.linalg.norm(shift_3) * 100:.0f} cm"
    )
    return found if _is_free(found, case.scene.truth[i], cfg) else None


def _resize(
    case: Scenario, i: int, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> Scenario | None:
    factor = float(rng.choice(cfg.factors))
    found = replace(resize_object(case, i, factor, window), words=f"one {factor:g} times as large")
    return found if factor < 1 or _is_free(found, case.scene.truth[i], cfg) else None


def _remove(
    case: Scenario, i: int, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> Scenario | None:
    return (
        replace(remove_object(case, i), words="one taken away")
        if len(case.episode.bodies) > 1
        else None
    )


def _add(
    case: Scenario, i: int, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> Scenario | None:
    shift_3 = _shift(cfg.add_m, rng)
    found = replace(
        add_object(case, i, shift_3), words=f"another, {np.linalg.norm(shift_3) * 100:.0f} cm away"
    )
    return found if _is_free(found, len(case.episode.bodies), cfg) else None


def _redirect(
    case: Scenario, i: int, cfg: EditsConfig, window: Grid, rng: np.random.Generator
) -> Scenario | None:
    turn_deg = float(rng.uniform(*cfg.turn_deg) * rng.choice([-1, 1]))
    side = "left" if turn_deg > 0 else "right"
    return replace(
        redirect_push(case, np.radians(turn_deg)),
        words=f"pushed {abs(turn_deg):.0f} degrees further {side}",
    )


EDIT_SAMPLERS: dict[str, EditSampler] = {
    "move": _move,
    "resize": _resize,
    "remove": _remove,
    "add": _add,
    "push": _redirect,
}


def _shift(lengths_m: tuple[float, float], rng: np.random.Generator) -> Floats:
    angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(*lengths_m)
    return length * np.array([np.cos(angle), np.sin(angle), 0.0])


def _is_free(case: Scenario, true_i: int, cfg: EditsConfig) -> bool:
    """Whether a true object's upright cylinder touches no other's and not the rod, and stands over
    the table.
    """
    first = case.episode.steps[0]
    middle_N2, radius_N = first.center_N3[:, :2], np.linalg.norm(first.size_N3[:, :2], axis=1) / 2
    aside_N = np.linalg.norm(middle_N2 - middle_N2[true_i], axis=1) - radius_N - radius_N[true_i]
    height_N, level_N = first.size_N3[:, 2] / 2, first.center_N3[:, 2]
    away_N = np.maximum(aside_N, np.abs(level_N - level_N[true_i]) - height_N - height_N[true_i])
    away_N[true_i] = np.inf
    to_rod = np.linalg.norm(first.tip_world_3[:2] - middle_N2[true_i]) - radius_N[true_i]
    is_apart = (
        away_N > cfg.gap_m
    ).all() and not to_rod < 2 * cfg.gap_m  # without a robot the tip is NaN
    return bool(is_apart and (np.abs(middle_N2[true_i]) + radius_N[true_i] < cfg.rim_m).all())
