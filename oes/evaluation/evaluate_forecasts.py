"""Errors of forecasts as rows: one row per true object, step and forecast (paper section 4.1)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import trimesh

from oes.dynamics import VARIANTS
from oes.episode import Episode, Floats
from oes.evaluation.forecasters import (
    Forecast,
    Forecaster,
    PerceivedScene,
    RolloutsConfig,
    forecast_steps,
    perceived_scenes,
    true_forecast,
)
from oes.evaluation.penetration import PenetrationMeter
from oes.geom.se3 import transform
from oes.meshes.catalogue import Catalogue
from oes.metrics.errors import error_nll, error_quantile, rotation_deg, surface_mm, translation_mm
from oes.perception.objects_file import ObjectStore
from oes.schema import ERRORS

Row = dict[str, object]

QUERY_STRIDE = 20  # every 20th surface point is a query; all of them are the reference


@dataclass(frozen=True)
class MeshGeometry:
    """Surface samples P3 of every mesh (obj frame, unit scale) and penetration among meshes."""

    surfaces: Mapping[str, Floats]
    penetration: PenetrationMeter


def mesh_geometry(catalogue: Catalogue, num_points: int) -> MeshGeometry:
    """``num_points`` samples of every mesh; the same catalogue gives the same samples."""
    surfaces = {
        mesh.id: np.asarray(trimesh.sample.sample_surface(mesh.visual, num_points, seed=0)[0])
        for mesh in catalogue.meshes.values()
    }
    queries = {name: points_P3[::QUERY_STRIDE] for name, points_P3 in surfaces.items()}
    return MeshGeometry(surfaces, PenetrationMeter(catalogue, queries))


def scored_settings(cfg: RolloutsConfig, model: str) -> dict[str, tuple[str, ...]]:
    """Perception settings by split on which a model, or an ablation of one, is evaluated."""
    return cfg.variants if model in VARIANTS else cfg.settings


def error_rows(
    forecaster: Forecaster,
    store: ObjectStore,
    episodes: Mapping[int, Episode],
    geometry: MeshGeometry,
    names: tuple[str, str, str],
    cfg: RolloutsConfig,
) -> Iterator[Row]:
    """Rows with the columns ``ERRORS`` of one split under all its settings.

    ``names``: task, model and split. Episodes that are not given are skipped. Raises ObjectsError
    for a setting that the objects file lacks. There is a row for each true object and step T (from
    1); undetected objects are forecast to stay.

    surface_mm          translation and rotation error together, valid for symmetric objects
    moved, detected     1 or 0
    penetration_mm      maximum pairwise penetration depth of the forecast pose
    sigma_mm            predicted scale of the translation error
    within_50, _90      1 if the error lies within the central 50% or 90% interval
    nll                 negative log-likelihood of the error in mm
    nll_homoscedastic   the same under one sigma for all objects at T

    The last five are None for models without an uncertainty estimate and for undetected objects.
    """
    task, model, split = names
    for setting in scored_settings(cfg, model)[split]:
        keys = (task, model, setting, split)
        scenes = perceived_scenes(store, setting, episodes)
        for scene, forecast in zip(scenes, forecaster(scenes, episodes), strict=True):
            yield from _scene_rows(keys, scene, forecast, episodes[scene.episode_i], geometry, cfg)


def _scene_rows(
    keys: tuple[str, str, str, str],
    scene: PerceivedScene,
    forecast: Forecast,
    episode: Episode,
    geometry: MeshGeometry,
    cfg: RolloutsConfig,
) -> Iterator[Row]:
    first = episode.steps[0]
    true = true_forecast(episode, first.center_N3)
    error_mm_TN = translation_mm(forecast.translation_TN3, true.translation_TN3)
    error_deg_TN = rotation_deg(forecast.rotation_TN33, true.rotation_TN33)
    moved_mm_N = translation_mm(true.translation_TN3[-1], np.zeros(3))
    moved_deg_N = rotation_deg(true.rotation_TN33[-1], np.eye(3))
    moved_N = (moved_mm_N > cfg.moved_mm) | (moved_deg_N > cfg.moved_deg)
    states = forecast_steps(episode, forecast)[1:]
    poses_TN44 = np.stack([state.world_T_obj_N44 for state in states])
    depth_mm_TN = geometry.penetration.depths_mm(episode, poses_TN44)
    steps, num = error_mm_TN.shape
    for n, body in enumerate(episode.bodies):
        surface_P3 = geometry.surfaces[body.mesh] * body.scale_3
        surface_P3 = transform(first.world_T_obj_N44[n], surface_P3) - first.center_N3[n]
        surface_mm_T = _surface_error_mm(surface_P3, forecast, true, n)
        for t in range(steps):
            errors = error_mm_TN[t, n], error_deg_TN[t, n], surface_mm_T[t], depth_mm_TN[t, n]
            error_mm, *others, depth_mm = (round(float(error), 4) for error in errors)
            values = (
                *(*keys, scene.episode_i, n, num, scene.num_views, t + 1, error_mm, *others),
                *(int(moved_N[n]), int(forecast.detected_N[n]), depth_mm),
                *_calibration(forecast, t, n, error_mm),
            )
            yield dict(zip(ERRORS, values, strict=True))


def _calibration(forecast: Forecast, t: int, n: int, error_mm: float) -> tuple[float | None, ...]:
    """``sigma_mm`` and the columns after it."""
    model = forecast.error_model
    if forecast.sigma_TN is None or model is None or not forecast.detected_N[n]:
        return (None,) * 5
    sigma_mm = float(forecast.sigma_TN[t, n]) * 1e3
    sigma_T = model.homoscedastic_sigma_T
    common_mm = sigma_T[min(t, len(sigma_T) - 1)] * 1e3
    within_50, within_90 = (
        int(error_mm < error_quantile(level, np.array(sigma_mm), model.dof)) for level in (0.5, 0.9)
    )
    nll, nll_homoscedastic = (
        round(float(error_nll(np.array(error_mm), np.array(sigma), dof)), 4)
        for sigma, dof in ((sigma_mm, model.dof), (common_mm, model.homoscedastic_dof))
    )
    return round(sigma_mm, 4), within_50, within_90, nll, nll_homoscedastic


def _surface_error_mm(surface_P3: Floats, forecast: Forecast, true: Forecast, n: int) -> Floats:
    """Surface distance T of object ``n``; ``surface_P3``: at t = 0, about its box centre."""
    shift_T3 = (forecast.translation_TN3 - true.translation_TN3)[:, n]
    R_T33 = forecast.rotation_TN33[:, n]
    predicted_TQ3 = surface_P3[::QUERY_STRIDE] @ R_T33.swapaxes(-1, -2) + shift_T3[:, None]
    # Queries go to the true object's frame, so that one k-d tree serves all steps.
    return surface_mm(predicted_TQ3 @ true.rotation_TN33[:, n], surface_P3)
