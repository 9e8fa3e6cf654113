"""Counterfactuals: forecasts of scenes that were changed, held against Bullet from the same change (4, A.2)."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oes.dynamics.unroll import Model
from oes.episode import Episode
from oes.geom.voxels import Grid
from oes.imagine.edits import Case, Edits, draw_edit
from oes.imagine.first import Motion, motions
from oes.imagine.quality import Row
from oes.measure import rotation_deg, translation_mm
from oes.meshes.catalogue import Catalogue
from oes.rollout import carried, truth_of
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.simulate import replay_bodies
from oes.sim.world import Sim

log = logging.getLogger(__name__)

AS_IT_WAS = "none"
EDIT_COLUMNS = ("task", "episode_i", "edit", "model", "object_i", "T", "translation_mm", "rotation_deg", "detected")


@dataclass(frozen=True)
class Answer:
    """A question of a kind, what came of it in the simulator, and what each model forecast."""

    kind: str
    case: Case
    happened: Episode
    found: Mapping[str, Motion]


def ask(
    case: Case,
    kinds: Sequence[str],
    cfg: Edits,
    window: Grid,
    rng: np.random.Generator,
    world: tuple[Catalogue, Sim, Mapping[str, Model]],
) -> Iterator[Answer]:
    """The case as it was, then a change of each kind that has a place and can be simulated, and the forecasts.

    ``world``: the catalogue, Bullet's settings and the models.
    """
    catalogue, sim, models = world
    for kind in (AS_IT_WAS, *kinds):
        changed = case if kind == AS_IT_WAS else draw_edit(kind, case, cfg, window, rng)
        if changed is None:
            continue
        try:
            happened = case.episode
            if changed is not case:
                happened = replay_bodies(catalogue, sim, changed.episode, changed.episode.bodies)
        except (ReachError, BulletError) as error:
            log.warning("episode %d, %s: left out, as the simulator cannot: %s", case.scene.episode_i, kind, error)
            continue
        yield Answer(kind, changed, happened, motions(changed, models))


def edit_rows(answer: Answer, times: Sequence[int]) -> Iterator[Row]:
    """Errors of each model and true object at each time; one that was not detected is forecast to stay."""
    case, happened = answer.case, answer.happened
    true = truth_of(happened, case.episode.steps[0].center_N3)
    about: Row = {"task": happened.task, "episode_i": case.scene.episode_i, "edit": answer.kind}
    for word, motion in answer.found.items():
        arrays = (motion.translation_TN3.double().numpy(), motion.rotation_TN33.double().numpy())
        found = carried(case.scene, case.episode, *arrays)
        error_mm_TN = translation_mm(found.translation_TN3, true.translation_TN3)
        error_deg_TN = rotation_deg(found.rotation_TN33, true.rotation_TN33)
        for object_i, T in np.ndindex(len(found.detected_N), len(times)):
            at = times[T] - 1
            yield {
                **about,
                "model": word,
                "object_i": object_i,
                "T": times[T],
                "translation_mm": round(float(error_mm_TN[at, object_i]), 4),
                "rotation_deg": round(float(error_deg_TN[at, object_i]), 4),
                "detected": int(found.detected_N[object_i]),
            }
