"""Counterfactuals: forecasts of scenes that were changed, held against Bullet from the same change
(4, A.2).
"""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oes.counterfactual.edits import EditsConfig, Scenario, draw_edit
from oes.counterfactual.evaluate import FutureRow
from oes.counterfactual.forecast import ObjectMotion, forecast_motions
from oes.dynamics.unroll import DynamicsModel
from oes.episode import Episode
from oes.evaluation.forecasters import to_gt_objects, true_forecast
from oes.geom.voxels import Grid
from oes.meshes.catalogue import Catalogue
from oes.metrics.errors import rotation_deg, translation_mm
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.simulate import replay_bodies
from oes.sim.world import SimConfig

log = logging.getLogger(__name__)

UNEDITED = "none"
EDIT_COLUMNS = (
    "task",
    "episode_i",
    "edit",
    "model",
    "object_i",
    "T",
    "translation_mm",
    "rotation_deg",
    "detected",
)


@dataclass(frozen=True)
class Counterfactual:
    """A question of a kind, what came of it in the simulator, and what each model forecast."""

    kind: str
    case: Scenario
    happened: Episode
    found: Mapping[str, ObjectMotion]


def run_counterfactual(
    case: Scenario,
    kinds: Sequence[str],
    cfg: EditsConfig,
    window: Grid,
    rng: np.random.Generator,
    world: tuple[Catalogue, SimConfig, Mapping[str, DynamicsModel]],
) -> Iterator[Counterfactual]:
    """The case as it was, then a change of each kind that has a place and can be simulated, and the
    forecasts.

    ``world``: the catalogue, Bullet's settings and the models.
    """
    catalogue, sim, models = world
    for kind in (UNEDITED, *kinds):
        changed = case if kind == UNEDITED else draw_edit(kind, case, cfg, window, rng)
        if changed is None:
            continue
        try:
            happened = case.episode
            if changed is not case:
                happened = replay_bodies(catalogue, sim, changed.episode, changed.episode.bodies)
        except (ReachError, BulletError) as error:
            log.warning(
                "episode %d, %s: left out, as the simulator cannot: %s",
                case.scene.episode_i,
                kind,
                error,
            )
            continue
        yield Counterfactual(kind, changed, happened, forecast_motions(changed, models))


def edit_rows(answer: Counterfactual, times: Sequence[int]) -> Iterator[FutureRow]:
    """Errors of each model and true object at each time; one that was not detected is forecast to
    stay.
    """
    case, happened = answer.case, answer.happened
    true = true_forecast(happened, case.episode.steps[0].center_N3)
    about: FutureRow = {
        "task": happened.task,
        "episode_i": case.scene.episode_i,
        "edit": answer.kind,
    }
    for word, motion in answer.found.items():
        arrays = (motion.translation_TN3.double().numpy(), motion.rotation_TN33.double().numpy())
        found = to_gt_objects(case.scene, case.episode, *arrays)
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
