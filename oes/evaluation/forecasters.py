"""Forecasts of test episodes (paper section 4.1).

Models forecast from perceived objects; the simulator itself forecasts from the true state.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from joblib import Parallel, delayed

from oes.config import Shared, params
from oes.dynamics.error_model import ErrorModel
from oes.dynamics.examples import padded, stack, true_motion
from oes.dynamics.models import GraphModel
from oes.dynamics.reference_models import Simulator
from oes.dynamics.unroll import DynamicsModel, unroll
from oes.episode import Bools, Episode, Floats, Step
from oes.geom.se3 import rigid
from oes.meshes.catalogue import Catalogue
from oes.objects import Objects
from oes.perception.objects_file import ObjectStore
from oes.sim.simulate import replay
from oes.sim.world import SimConfig

CHUNKS = 16  # jobs of a replay; more than workers, so that the last ones finish together


@params
class FilmstripsConfig:
    """Film strips of the first ``count`` episodes of one split per task, under one setting.

    The camera stands on the rig's sphere at its own angles and has a square image.
    """

    splits: dict[str, str]
    setting: str
    count: int
    azimuth_deg: float
    elevation_deg: float
    fov_deg: float
    size_px: int


@params
class RolloutsConfig:
    """The section ``rollouts``.

    ``settings``: perception settings by test split; ``variants``: the same for ablations.
    ``moved_mm``, ``moved_deg``: an object that exceeds either by the last step counts as moved.
    ``num_surface_points``: samples of each mesh's surface. ``num_workers``: for the simulator.
    """

    settings: dict[str, tuple[str, ...]]
    variants: dict[str, tuple[str, ...]]
    moved_mm: float
    moved_deg: float
    num_surface_points: int
    filmstrips: FilmstripsConfig
    num_workers: int
    sim: Shared[SimConfig]


@dataclass(frozen=True)
class Forecast:
    """Motion of an episode's N true objects since t = 0, at their true box centres (world, metres).

    ``sigma_TN``: scale of the translation error (metres) under ``error_model``, NaN for undetected
    objects; both are None for models without an uncertainty estimate.
    """

    translation_TN3: Floats
    rotation_TN33: Floats
    detected_N: Bools
    sigma_TN: Floats | None = None
    error_model: ErrorModel | None = None


@dataclass(frozen=True)
class PerceivedScene:
    """The first state of an episode as perceived.

    ``truth``: index of each object's match among the true objects, -1 for none.
    """

    episode_i: int
    num_views: int
    objects: Objects
    truth: Sequence[int]

    @property
    def matches(self) -> list[tuple[int, int]]:
        """Indices of matched objects: perceived, true."""
        return [(n, true_i) for n, true_i in enumerate(self.truth) if true_i >= 0]


Forecaster = Callable[[Sequence[PerceivedScene], Mapping[int, Episode]], list[Forecast]]


def perceived_scenes(
    store: ObjectStore, setting: str, episodes: Mapping[int, Episode]
) -> list[PerceivedScene]:
    """Scenes of one setting whose episodes are given.

    Raises ObjectsError for a setting that the file lacks.
    """
    scenes = []
    for observation_i in store.observations(setting):
        episode_i, num_views = store.episode(observation_i), len(store.views(observation_i))
        if episode_i in episodes:
            objects, gt_N = store.scene(observation_i)
            scenes.append(PerceivedScene(episode_i, num_views, objects, gt_N.tolist()))
    return scenes


def with_oracle_shapes(model: DynamicsModel | Simulator, store: ObjectStore) -> ObjectStore:
    """Objects as the model's inputs: with ground-truth surfaces for the ablation that uses them."""
    is_oracle = isinstance(model, GraphModel) and model.net.contact.gt_surfaces
    return store.with_gt_surfaces() if is_oracle else store


def make_forecaster(
    model: DynamicsModel | Simulator, catalogue: Catalogue, cfg: RolloutsConfig
) -> Forecaster:
    """The forecaster for a model of ``oes.dynamics.MODELS``."""
    if isinstance(model, Simulator):
        return SimulatorForecaster(model, catalogue, cfg)
    return ModelForecaster(model)


@dataclass(frozen=True)
class ModelForecaster:
    """Forecasts of a learned model from perceived objects; all scenes are one batch."""

    model: DynamicsModel

    @torch.inference_mode()
    def __call__(
        self, scenes: Sequence[PerceivedScene], episodes: Mapping[int, Episode]
    ) -> list[Forecast]:
        if not scenes:
            return []
        num = max(len(scene.truth) for scene in scenes)
        objects = stack([padded(scene.objects, num) for scene in scenes])
        recorded = [episodes[scene.episode_i] for scene in scenes]
        tip_B3 = np.stack([episode.steps[0].tip_world_3 for episode in recorded])
        actions_BT3 = np.stack([episode.actions_T3 for episode in recorded])
        inputs = (torch.from_numpy(x).float() for x in (tip_B3, actions_BT3))
        rollout = unroll(self.model, objects, *inputs)
        motion = (x.double().numpy() for x in (rollout.translation_BTN3, rollout.rotation_BTN33))
        forecasts = [to_gt_objects(*args) for args in zip(scenes, recorded, *motion, strict=True)]
        if rollout.sigma_BTN is None:
            return forecasts
        for b, scene in enumerate(scenes):
            sigma_TN = np.full(forecasts[b].translation_TN3.shape[:2], np.nan)
            for n, true_i in scene.matches:
                sigma_TN[:, true_i] = rollout.sigma_BTN[b, :, n].double().numpy()
            error_model = self.model.error_model
            forecasts[b] = replace(forecasts[b], sigma_TN=sigma_TN, error_model=error_model)
        return forecasts


class SimulatorForecaster:
    """Forecasts of Bullet from the true initial state with the mean mass and friction.

    Perception plays no part, so each episode is simulated once.
    """

    def __init__(self, simulator: Simulator, catalogue: Catalogue, cfg: RolloutsConfig) -> None:
        self.mass_kg, self.friction = float(simulator.mass_kg), float(simulator.friction)
        self.catalogue, self.sim, self.num_workers = catalogue, cfg.sim, cfg.num_workers
        self._cache: dict[tuple[str, int], Forecast] = {}

    def __call__(
        self, scenes: Sequence[PerceivedScene], episodes: Mapping[int, Episode]
    ) -> list[Forecast]:
        recorded = {_key(episodes[scene.episode_i]): episodes[scene.episode_i] for scene in scenes}
        new = [episode for key, episode in recorded.items() if key not in self._cache]
        chunks = [new[i::CHUNKS] for i in range(min(CHUNKS, len(new)))]
        jobs = (delayed(self._replay)(chunk) for chunk in chunks)
        for forecasts in Parallel(n_jobs=self.num_workers)(jobs):
            self._cache |= forecasts
        return [self._cache[_key(episodes[scene.episode_i])] for scene in scenes]

    def _replay(self, episodes: Sequence[Episode]) -> dict[tuple[str, int], Forecast]:
        forecasts = {}
        for episode in episodes:
            replayed = replay(self.catalogue, self.sim, episode, self.mass_kg, self.friction)
            forecasts[_key(episode)] = true_forecast(replayed, episode.steps[0].center_N3)
        return forecasts


def _key(episode: Episode) -> tuple[str, int]:
    return episode.split, episode.index


def to_gt_objects(
    scene: PerceivedScene, episode: Episode, translation_TN3: Floats, rotation_TN33: Floats
) -> Forecast:
    """Forecast of true objects from the motion of perceived objects about their own centres.

    Undetected objects are forecast to stay.
    """
    center_N3 = episode.steps[0].center_N3
    steps, num = len(episode.actions_T3), len(center_N3)
    gt_translation_TN3, detected_N = np.zeros((steps, num, 3)), np.zeros(num, dtype=bool)
    gt_rotation_TN33 = np.tile(np.eye(3), (steps, num, 1, 1))
    for n, true_i in scene.matches:
        # A rigid motion about the perceived centre moves the true centre by R d - d + t.
        offset_3 = center_N3[true_i] - scene.objects.center_N3[n].double().numpy()
        lever_T3 = rotation_TN33[:, n] @ offset_3 - offset_3
        gt_translation_TN3[:, true_i] = lever_T3 + translation_TN3[:, n]
        gt_rotation_TN33[:, true_i] = rotation_TN33[:, n]
        detected_N[true_i] = True
    return Forecast(gt_translation_TN3, gt_rotation_TN33, detected_N)


def true_forecast(episode: Episode, center_N3: Floats) -> Forecast:
    """Recorded motion of the points ``center_N3`` of an episode's objects."""
    motions = [true_motion(episode.steps, i, center_3) for i, center_3 in enumerate(center_N3)]
    translation_TN3, rotation_TN33 = (np.stack(x, axis=1) for x in zip(*motions, strict=True))
    return Forecast(translation_TN3, rotation_TN33, np.ones(len(center_N3), dtype=bool))


def forecast_steps(episode: Episode, forecast: Forecast) -> list[Step]:
    """The episode's I states with its objects at their forecast poses."""
    first = episode.steps[0]
    steps = [first]
    for t, step in enumerate(episode.steps[1:]):
        R_N33 = forecast.rotation_TN33[t]
        origin_N3 = (R_N33 @ -first.center_N3[..., None])[..., 0]
        origin_N3 = origin_N3 + first.center_N3 + forecast.translation_TN3[t]
        world_T_obj_N44 = rigid(R_N33, origin_N3) @ first.world_T_obj_N44
        steps.append(replace(step, world_T_obj_N44=world_T_obj_N44))
    return steps
