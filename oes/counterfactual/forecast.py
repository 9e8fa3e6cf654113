"""Counterfactuals: edited scenarios, forecast by models and simulated by Bullet (4, A.2)."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from oes.counterfactual.compose import DecomposedScene, PoseTable, decompose_scene, initial_poses
from oes.counterfactual.edits import EditsConfig, Scenario, draw_edit
from oes.dynamics.examples import stack, true_motion
from oes.dynamics.unroll import DynamicsModel, unroll
from oes.episode import Episode
from oes.evaluation.forecasters import PerceivedScene
from oes.geom.voxels import Grid
from oes.meshes.catalogue import Catalogue
from oes.perception.evaluate import match_detections
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.simulate import replay_bodies
from oes.sim.world import SimConfig

log = logging.getLogger(__name__)

STATIC, TRUTH = "static", "truth"  # names of motions besides the models'
UNEDITED = "none"


@dataclass(frozen=True)
class ObjectMotion:
    """Motion of the perceived objects since the first state (metres, world axes).

    Rotations are about the perceived centres.
    """

    translation_TN3: Tensor
    rotation_TN33: Tensor

    def poses(self, initial: PoseTable, T: int) -> PoseTable:
        """Poses after T steps; the rotations are about the centres in ``initial``."""
        if T == 0:
            return initial
        return replace(
            initial,
            rotation_N33=self.rotation_TN33[T - 1] @ initial.rotation_N33,
            translation_N3=initial.translation_N3 + self.translation_TN3[T - 1],
        )


@dataclass(frozen=True)
class Counterfactual:
    """A scenario, the type of its edit, its simulation and the forecasts of each model."""

    edit: str
    scenario: Scenario
    simulated: Episode
    forecasts: Mapping[str, ObjectMotion]


def perceive_first_state(
    perceiver: Perceiver, source: FrameSource, episode_i: int, camera_i: int
) -> tuple[Scenario, DecomposedScene]:
    """The unedited scenario as perceived by one camera in the first state."""
    episode = source.episodes[episode_i]
    frames, cameras = source.read(episode_i, 0, [camera_i])
    features = perceiver.encode(frames, cameras)
    objects = perceiver.objects(features, perceiver.detect(features), frames, cameras)
    centers = objects.center_N3.double().numpy()
    truth = match_detections(centers, episode.steps[0].center_N3).tolist()
    scene = PerceivedScene(episode_i, 1, objects, truth)
    scenario = Scenario("as it was", episode, scene, initial_poses(len(truth)))
    return scenario, decompose_scene(perceiver, features, objects)


@torch.inference_mode()
def forecast_motions(
    scenario: Scenario, models: Mapping[str, DynamicsModel]
) -> dict[str, ObjectMotion]:
    """The forecast of each model, and no motion (``static``)."""
    num_steps, count = len(scenario.episode.actions_T3), len(scenario.scene.truth)
    eye_TN33 = torch.eye(3).expand(num_steps, count, 3, 3)
    motions = {STATIC: ObjectMotion(torch.zeros(num_steps, count, 3), eye_TN33)}
    objects = stack([scenario.scene.objects])
    tip_13 = torch.from_numpy(scenario.episode.steps[0].tip_world_3).float()[None]
    actions_1T3 = torch.from_numpy(scenario.episode.actions_T3).float()[None]
    for name, model in models.items():
        rollout = unroll(model, objects, tip_13, actions_1T3)
        motions[name] = ObjectMotion(rollout.translation_BTN3[0], rollout.rotation_BTN33[0])
    return motions


def true_motions(scenario: Scenario, simulated: Episode) -> ObjectMotion:
    """The simulated motion of the perceived objects; false detections are static."""
    num_steps, count = len(simulated.actions_T3), len(scenario.scene.truth)
    translation_TN3 = np.zeros((num_steps, count, 3))
    rotation_TN33 = np.tile(np.eye(3), (num_steps, count, 1, 1))
    for i, true_i in enumerate(scenario.scene.truth):
        if true_i >= 0:
            center_3 = scenario.scene.objects.center_N3[i].double().numpy()
            motion = true_motion(simulated.steps, true_i, center_3)
            translation_TN3[:, i], rotation_TN33[:, i] = motion
    return ObjectMotion(*(torch.from_numpy(x).float() for x in (translation_TN3, rotation_TN33)))


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
