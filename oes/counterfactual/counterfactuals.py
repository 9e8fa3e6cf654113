"""Counterfactuals: forecasts of edited scenarios, compared with Bullet's simulation (4, A.2)."""

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


@dataclass(frozen=True)
class Counterfactual:
    """A scenario, the type of its edit, its simulation and the forecasts of each model."""

    edit: str
    scenario: Scenario
    simulated: Episode
    forecasts: Mapping[str, ObjectMotion]


def run_counterfactuals(
    scenario: Scenario,
    edits: Sequence[str],
    cfg: EditsConfig,
    window: Grid,
    rng: np.random.Generator,
    world: tuple[Catalogue, SimConfig, Mapping[str, DynamicsModel]],
) -> Iterator[Counterfactual]:
    """The unedited scenario, then a random edit of each type, simulated and forecast.

    Edits that are not feasible or cannot be simulated are left out.
    """
    catalogue, sim, models = world
    yield Counterfactual(UNEDITED, scenario, scenario.episode, forecast_motions(scenario, models))
    for edit in edits:
        edited = draw_edit(edit, scenario, cfg, window, rng)
        if edited is None:
            continue
        try:
            simulated = replay_bodies(catalogue, sim, edited.episode, edited.episode.bodies)
        except (ReachError, BulletError) as error:
            log.warning("episode %d: %s left out: %s", scenario.scene.episode_i, edit, error)
            continue
        yield Counterfactual(edit, edited, simulated, forecast_motions(edited, models))


def edit_rows(counterfactual: Counterfactual, horizons: Sequence[int]) -> Iterator[FutureRow]:
    """Errors per model, true object and horizon (steps); undetected objects count as static."""
    scenario, simulated = counterfactual.scenario, counterfactual.simulated
    true = true_forecast(simulated, scenario.episode.steps[0].center_N3)
    for name, motion in counterfactual.forecasts.items():
        arrays = (motion.translation_TN3.double().numpy(), motion.rotation_TN33.double().numpy())
        forecast = to_gt_objects(scenario.scene, scenario.episode, *arrays)
        error_mm_TN = translation_mm(forecast.translation_TN3, true.translation_TN3)
        error_deg_TN = rotation_deg(forecast.rotation_TN33, true.rotation_TN33)
        for object_i, T in ((i, T) for i in range(len(forecast.detected_N)) for T in horizons):
            yield {
                "task": simulated.task,
                "episode_i": scenario.scene.episode_i,
                "edit": counterfactual.edit,
                "model": name,
                "object_i": object_i,
                "T": T,
                "translation_mm": round(float(error_mm_TN[T - 1, object_i]), 4),
                "rotation_deg": round(float(error_deg_TN[T - 1, object_i]), 4),
                "detected": int(forecast.detected_N[object_i]),
            }
