"""What models forecast of test episodes: those that see what perception saw, and Bullet itself
(paper section 4.1).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from joblib import Parallel, delayed
from numpy.typing import NDArray

from oes.config import Shared, params
from oes.dynamics.error_model import ErrorModel
from oes.dynamics.examples import padded, stack, true_motion
from oes.dynamics.models import GraphModel
from oes.dynamics.reference_models import Simulator
from oes.dynamics.unroll import DynamicsModel, unroll
from oes.episode import Episode, Floats
from oes.meshes.catalogue import Catalogue
from oes.objects import Objects
from oes.perception.objects_file import ObjectStore
from oes.sim.simulate import replay
from oes.sim.world import SimConfig

Bools = NDArray[np.bool_]

CHUNKS = 16


@params
class StripsConfig:
    """Pictures of forecasts beside the truth: of the first ``count`` episodes of each task's
    ``splits``, under one setting, seen by a camera on the rig's sphere with its own angles and
    image.
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
    """The section ``rollouts``: settings scored on each test split (``variants``: those of
    ablations), what is moved, points on each surface, pictures, and Bullet for the replay.
    """

    settings: dict[str, tuple[str, ...]]
    variants: dict[str, tuple[str, ...]]
    moved_mm: float
    moved_deg: float
    num_surface_points: int
    strips: StripsConfig
    num_workers: int
    sim: Shared[SimConfig]


@dataclass(frozen=True)
class Forecast:
    """Where a model puts the true objects of one episode: motion since t = 0 of each object's true
    box centre; and, of models that tell, how sure it is: the scale of the translation's error
    (metres), and the law it belongs to.
    """

    translation_TN3: Floats
    rotation_TN33: Floats
    detected_N: Bools
    scale_TN: Floats | None = None
    certainty: ErrorModel | None = None


@dataclass(frozen=True)
class PerceivedScene:
    """One draw: the episode's number, how many views, the perceived objects and the true one of
    each (-1: none).
    """

    episode_i: int
    num_views: int
    objects: Objects
    truth: Sequence[int]


def perceived_scenes(
    store: ObjectStore, setting: str, episodes: Mapping[int, Episode]
) -> list[PerceivedScene]:
    """The draws of a setting, but for missing episodes. Raises ObjectsError for a setting that the
    file lacks.
    """
    draw_is = [draw_i for draw_i in store.draws(setting) if store.episode(draw_i) in episodes]
    return [_scene(store, draw_i) for draw_i in draw_is]


def with_oracle_shapes(model: DynamicsModel | Simulator, store: ObjectStore) -> ObjectStore:
    """The perceived objects as a model is to see them: with their true surfaces, if it is an
    ablation that says so.
    """
    is_told = isinstance(model, GraphModel) and model.net.contact.gt_surfaces
    return store.with_gt_surfaces() if is_told else store


def _scene(store: ObjectStore, draw_i: int) -> PerceivedScene:
    objects, truth = store.scene(draw_i)
    return PerceivedScene(store.episode(draw_i), len(store.views(draw_i)), objects, truth.tolist())


Forecaster = Callable[[Sequence[PerceivedScene], Mapping[int, Episode]], list[Forecast]]


@dataclass(frozen=True)
class ModelForecaster:
    """Forecasts of a model that sees what perception saw."""

    model: DynamicsModel

    @torch.inference_mode()
    def __call__(
        self, scenes: Sequence[PerceivedScene], episodes: Mapping[int, Episode]
    ) -> list[Forecast]:
        """All scenes as one batch."""
        if not scenes:
            return []
        most = max(len(scene.truth) for scene in scenes)
        objects = stack([padded(scene.objects, most) for scene in scenes])
        chosen = [episodes[scene.episode_i] for scene in scenes]
        tip_B3 = torch.from_numpy(
            np.stack([episode.steps[0].tip_world_3 for episode in chosen])
        ).float()
        actions_BT3 = torch.from_numpy(np.stack([episode.actions_T3 for episode in chosen])).float()
        found = unroll(self.model, objects, tip_B3, actions_BT3)
        motions = zip(
            found.translation_BTN3.double().numpy(),
            found.rotation_BTN33.double().numpy(),
            strict=True,
        )
        carry = [
            to_gt_objects(scene, episode, *motion)
            for scene, episode, motion in zip(scenes, chosen, motions, strict=True)
        ]
        if found.sigma_BTN is None:
            return carry
        scales_BTN = found.sigma_BTN.double().numpy()
        return [
            replace(
                forecast,
                scale_TN=_of_true(scene, scale_TN, len(forecast.detected_N)),
                certainty=self.model.error_model,
            )
            for forecast, scene, scale_TN in zip(carry, scenes, scales_BTN, strict=True)
        ]


class SimulatorForecaster:
    """Forecasts of Bullet from the true start with the mean mass and friction; each episode is run
    once.
    """

    def __init__(self, simulator: Simulator, catalogue: Catalogue, cfg: RolloutsConfig) -> None:
        self.mass_kg, self.friction = float(simulator.mass_kg), float(simulator.friction)
        self.catalogue, self.sim, self.num_workers = catalogue, cfg.sim, cfg.num_workers
        self.known: dict[tuple[str, int], Forecast] = {}

    def __call__(
        self, scenes: Sequence[PerceivedScene], episodes: Mapping[int, Episode]
    ) -> list[Forecast]:
        """What is drawn or detected plays no part."""
        chosen = [episodes[scene.episode_i] for scene in scenes]
        new = [
            episode
            for episode in {_key(e): e for e in chosen}.values()
            if _key(episode) not in self.known
        ]
        chunks = [chunk for chunk in (new[i::CHUNKS] for i in range(CHUNKS)) if chunk]
        for run in Parallel(n_jobs=self.num_workers)(
            delayed(self._replay)(chunk) for chunk in chunks
        ):
            self.known |= run
        return [self.known[_key(episode)] for episode in chosen]

    def _replay(self, episodes: Sequence[Episode]) -> dict[tuple[str, int], Forecast]:
        out = {}
        for episode in episodes:
            again = replay(self.catalogue, self.sim, episode, self.mass_kg, self.friction)
            out[_key(episode)] = true_forecast(again, episode.steps[0].center_N3)
        return out


def to_gt_objects(
    scene: PerceivedScene, episode: Episode, translation_TN3: Floats, rotation_TN33: Floats
) -> Forecast:
    """The forecast motion of the perceived objects, about their perceived centres, applied to the
    true box centres.
    """
    true_N3 = episode.steps[0].center_N3
    steps, num = len(episode.actions_T3), len(true_N3)
    moved_TN3, turned_TN33 = np.zeros((steps, num, 3)), np.tile(np.eye(3), (steps, num, 1, 1))
    detected_N = np.zeros(num, dtype=bool)
    for i, object_i in enumerate(scene.truth):
        if object_i < 0:
            continue
        from_center_3 = true_N3[object_i] - scene.objects.center_N3[i].double().numpy()
        moved_TN3[:, object_i] = (
            rotation_TN33[:, i] @ from_center_3 - from_center_3 + translation_TN3[:, i]
        )
        turned_TN33[:, object_i] = rotation_TN33[:, i]
        detected_N[object_i] = True
    return Forecast(moved_TN3, turned_TN33, detected_N)


def _of_true(scene: PerceivedScene, scale_TM: Floats, num: int) -> Floats:
    """Scales TN of true objects, of those TM of perceived ones; NaN for what was not detected."""
    scale_TN = np.full((len(scale_TM), num), np.nan)
    for i, object_i in enumerate(scene.truth):
        if object_i >= 0:
            scale_TN[:, object_i] = scale_TM[:, i]
    return scale_TN


def true_forecast(episode: Episode, center_N3: Floats) -> Forecast:
    """What happened in an episode to the points ``center_N3`` of its objects."""
    motions = [true_motion(episode.steps, i, center_3) for i, center_3 in enumerate(center_N3)]
    translation_TN3, rotation_TN33 = (
        np.stack(parts, axis=1) for parts in zip(*motions, strict=True)
    )
    return Forecast(translation_TN3, rotation_TN33, np.ones(len(center_N3), dtype=bool))


def make_forecaster(
    model: DynamicsModel | Simulator, catalogue: Catalogue, cfg: RolloutsConfig
) -> Forecaster:
    """How a model of ``MODELS`` forecasts."""
    return (
        SimulatorForecaster(model, catalogue, cfg)
        if isinstance(model, Simulator)
        else ModelForecaster(model)
    )


def _key(episode: Episode) -> tuple[str, int]:
    return episode.split, episode.index
