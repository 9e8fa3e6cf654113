"""Forecasts held against what happened: every error of every step as rows, and pictures of both
(paper section 4.1).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
import trimesh
from numpy.typing import NDArray

from oes.dynamics import VARIANTS
from oes.episode import Camera, Episode, Floats, Step
from oes.episodes.capture import scene_renderer
from oes.evaluation.forecasters import (
    Forecast,
    Forecaster,
    PerceivedScene,
    RolloutsConfig,
    perceived_scenes,
    true_forecast,
)
from oes.evaluation.penetration import PenetrationMeter
from oes.geom.camera import intrinsics, look_at
from oes.geom.se3 import rigid, transform
from oes.meshes.catalogue import Catalogue
from oes.metrics.errors import error_nll, error_quantile, rotation_deg, surface_mm, translation_mm
from oes.perception.objects_file import ObjectStore
from oes.render.scene import mesh_poses
from oes.sim.rig import direction

Surfaces = Mapping[str, Floats]
Calibration = tuple[float | None, float | None, float | None, float | None, float | None]

QUERY_EVERY = 20  # of a surface's points, those whose distance is taken


@dataclass(frozen=True)
class ErrorRow:
    """One true object at one step of one forecast; an object that was not detected is forecast to
    stay.

    ``surface_mm`` (``oes.metrics.errors``) is the error that is right for symmetric objects, of
    translation and rotation both. ``penetration_mm``: how deep the object, as forecast, is in
    another, or that in it. Of models that tell how sure they are, for detected objects: the scale
    of the error expected, whether (1 or 0) the true one lies within the intervals of 50% and 90%,
    its negative log-likelihood (of its length in mm), and that under one scale for all at T.
    """

    task: str
    model: str
    setting: str
    split: str
    episode_i: int
    object_i: int
    num_objects: int
    num_views: int
    T: int
    translation_mm: float
    rotation_deg: float
    surface_mm: float
    moved: int
    detected: int
    penetration_mm: float
    scale_mm: float | None
    within_50: float | None
    within_90: float | None
    nll: float | None
    nll_same: float | None


ERROR_COLUMNS = tuple(field.name for field in fields(ErrorRow))


def sample_mesh_surfaces(catalogue: Catalogue, count: int) -> Surfaces:
    """``count`` points of every mesh's surface, P3 in its obj frame; the same catalogue gives the
    same points.
    """
    return {
        mesh.id: np.asarray(trimesh.sample.sample_surface(mesh.visual, count, seed=0)[0])
        for mesh in catalogue.meshes.values()
    }


def penetration_meter(catalogue: Catalogue, surfaces: Surfaces) -> PenetrationMeter:
    """Penetration among the catalogue's meshes, by some of the points of their surfaces."""
    return PenetrationMeter(
        catalogue, {name: points_P3[::QUERY_EVERY] for name, points_P3 in surfaces.items()}
    )


def split_rows(
    forecast: Forecaster,
    store: ObjectStore,
    episodes: Mapping[int, Episode],
    surfaces: Surfaces,
    overlaps: PenetrationMeter,
    words: tuple[str, str, str],
    cfg: RolloutsConfig,
) -> Iterator[ErrorRow]:
    """The rows of every setting of one split; ``words`` are task, model and split. Missing episodes
    are skipped.

    Raises ObjectsError for a setting that the objects file does not have.
    """
    task, model, split = words
    for setting in settings_of(cfg, model)[split]:
        scenes = perceived_scenes(store, setting, episodes)
        for scene, found in zip(scenes, forecast(scenes, episodes), strict=True):
            episode = episodes[scene.episode_i]
            poses_TN44 = np.stack(
                [step.world_T_obj_N44 for step in forecast_steps(episode, found)[1:]]
            )
            depth_mm_TN = overlaps.depths_mm(episode, poses_TN44)
            yield from _rows(
                (task, model, setting, split), scene, found, episode, surfaces, depth_mm_TN, cfg
            )


def settings_of(cfg: RolloutsConfig, model: str) -> dict[str, tuple[str, ...]]:
    """The settings that a model is scored on, by split."""
    return cfg.variants if model in VARIANTS else cfg.settings


def _rows(
    words: tuple[str, str, str, str],
    scene: PerceivedScene,
    found: Forecast,
    episode: Episode,
    surfaces: Surfaces,
    depth_mm_TN: Floats,
    cfg: RolloutsConfig,
) -> Iterator[ErrorRow]:
    """The errors of one forecast; ``words`` are task, model, setting and split."""
    true = true_forecast(episode, episode.steps[0].center_N3)
    error_mm_TN = translation_mm(found.translation_TN3, true.translation_TN3)
    error_deg_TN = rotation_deg(found.rotation_TN33, true.rotation_TN33)
    moved_mm_N = translation_mm(true.translation_TN3[-1], np.zeros(3))
    moved_N = (moved_mm_N > cfg.moved_mm) | (
        rotation_deg(true.rotation_TN33[-1], np.eye(3)) > cfg.moved_deg
    )
    steps, num = error_mm_TN.shape
    for object_i, body in enumerate(episode.bodies):
        about = (scene.episode_i, object_i, num, scene.num_views)
        flags = (int(moved_N[object_i]), int(found.detected_N[object_i]))
        first_P3 = transform(
            episode.steps[0].world_T_obj_N44[object_i], surfaces[body.mesh] * body.scale_3
        )
        apart_mm_T = _apart_mm(
            first_P3 - episode.steps[0].center_N3[object_i], found, true, object_i
        )
        for t in range(steps):
            values = (error_mm_TN[t, object_i], error_deg_TN[t, object_i], apart_mm_T[t])
            mm, deg, apart_mm = (round(float(value), 4) for value in values)
            depth_mm = round(float(depth_mm_TN[t, object_i]), 4)
            yield ErrorRow(
                *words,
                *about,
                t + 1,
                mm,
                deg,
                apart_mm,
                *flags,
                depth_mm,
                *_sure(found, t, object_i, mm),
            )


def _sure(found: Forecast, t: int, object_i: int, error_mm: float) -> Calibration:
    """``scale_mm`` and what follows it in a row."""
    law = found.certainty
    if found.scale_TN is None or law is None or not found.detected_N[object_i]:
        return None, None, None, None, None
    scale_mm = float(found.scale_TN[t, object_i]) * 1e3
    within = [
        int(error_mm < error_quantile(level, np.array(scale_mm), law.dof)) for level in (0.5, 0.9)
    ]
    same_mm = law.homoscedastic_sigma_T[min(t, len(law.homoscedastic_sigma_T) - 1)] * 1e3
    nll = [
        round(float(error_nll(np.array(error_mm), np.array(scale), tail)), 4)
        for scale, tail in ((scale_mm, law.dof), (same_mm, law.homoscedastic_dof))
    ]
    return round(scale_mm, 4), within[0], within[1], nll[0], nll[1]


def _apart_mm(surface_P3: Floats, found: Forecast, true: Forecast, object_i: int) -> Floats:
    """Distance T of an object's surface, as forecast, from where it is; ``surface_P3`` about its
    centre at first.
    """
    shift_T3 = (found.translation_TN3 - true.translation_TN3)[:, object_i]
    there_TQ3 = (
        surface_P3[::QUERY_EVERY] @ found.rotation_TN33[:, object_i].swapaxes(-1, -2)
        + shift_T3[:, None]
    )
    return surface_mm(there_TQ3 @ true.rotation_TN33[:, object_i], surface_P3)


def strips(
    forecast: Forecaster,
    store: ObjectStore,
    episodes: Mapping[int, Episode],
    catalogue: Catalogue,
    cfg: RolloutsConfig,
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Pictures of some forecasts by episode: T + 1 square tiles side by side, the truth above, the
    forecast below.
    """
    scenes = perceived_scenes(store, cfg.strips.setting, episodes)[: cfg.strips.count]
    camera = _camera(cfg)
    for scene, found in zip(scenes, forecast(scenes, episodes), strict=True):
        episode = episodes[scene.episode_i]
        renderer = scene_renderer(episode, catalogue, cfg.sim)
        rows = [
            np.hstack([renderer.render(mesh_poses(step), [camera]).rgb_VHW3[0] for step in steps])
            for steps in (episode.steps, forecast_steps(episode, found))
        ]
        yield scene.episode_i, np.vstack(rows)


def forecast_steps(episode: Episode, found: Forecast) -> list[Step]:
    """The episode's states with its objects where a forecast puts them."""
    first = episode.steps[0]
    out = [first]
    for t, step in enumerate(episode.steps[1:]):
        turned_N33 = found.rotation_TN33[t]
        origin_N3 = (
            (turned_N33 @ -first.center_N3[..., None])[..., 0]
            + first.center_N3
            + found.translation_TN3[t]
        )
        out.append(
            replace(step, world_T_obj_N44=rigid(turned_N33, origin_N3) @ first.world_T_obj_N44)
        )
    return out


def _camera(cfg: RolloutsConfig) -> Camera:
    """The camera of the pictures."""
    strips, rig = cfg.strips, cfg.sim.rig
    target = np.array(rig.target_m)
    eye = target + rig.distance_m * direction(
        np.radians(strips.elevation_deg), np.radians(strips.azimuth_deg)
    )
    K_33 = intrinsics(strips.fov_deg, strips.size_px, strips.size_px)
    return Camera("strip", K_33, look_at(eye, target), strips.size_px, strips.size_px)
