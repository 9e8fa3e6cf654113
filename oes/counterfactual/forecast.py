"""What is made of an episode's first photograph, and how models say its objects move from there."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from oes.counterfactual.compose import (
    DecomposedScene,
    PoseTable,
    decompose,
    forecast_poses,
    initial_poses,
)
from oes.counterfactual.edits import Scenario
from oes.dynamics.examples import stack, true_motion
from oes.dynamics.unroll import DynamicsModel, unroll
from oes.episode import Episode, Floats
from oes.evaluation.forecasters import PerceivedScene
from oes.perception.evaluate import match_detections
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource

STATIC, TRUTH = "static", "truth"


@dataclass(frozen=True)
class ObjectMotion:
    """Of perceived objects since the first state, about their perceived centres: TN3 (metres) and
    TN33, world axes.
    """

    translation_TN3: Tensor
    rotation_TN33: Tensor

    def poses(self, first: PoseTable, T: int) -> PoseTable:
        """What is drawn after T steps (0: at first)."""
        return (
            first
            if T == 0
            else forecast_poses(first, self.rotation_TN33[T - 1], self.translation_TN3[T - 1])
        )


def perceive_first_state(
    perceiver: Perceiver, source: FrameSource, episode_i: int, camera_i: int
) -> tuple[Scenario, DecomposedScene]:
    """The first state of an episode as one of its cameras shows it: objects found, and the map
    taken apart.
    """
    episode = source.episodes[episode_i]
    frames, cameras = source.read(episode_i, 0, [camera_i])
    scene = perceiver.encode(frames, cameras)
    objects = perceiver.objects(scene, *perceiver.detect(scene), frames, cameras)
    truth = match_detections(
        objects.center_N3.double().numpy(), episode.steps[0].center_N3
    ).tolist()
    case = Scenario(
        "as it was",
        episode,
        PerceivedScene(episode_i, 1, objects, truth),
        initial_poses(len(truth)),
    )
    return case, decompose(perceiver, scene, objects)


def forecast_motions(
    case: Scenario, models: Mapping[str, DynamicsModel]
) -> dict[str, ObjectMotion]:
    """What each model forecasts of a case, and that nothing moves (``static``)."""
    steps, count = len(case.episode.actions_T3), len(case.scene.truth)
    still = ObjectMotion(torch.zeros(steps, count, 3), torch.eye(3).expand(steps, count, 3, 3))
    return {STATIC: still, **{word: _forecast(case, model) for word, model in models.items()}}


@torch.inference_mode()
def _forecast(case: Scenario, model: DynamicsModel) -> ObjectMotion:
    tip_13 = torch.from_numpy(case.episode.steps[0].tip_world_3).float()[None]
    actions_1T3 = torch.from_numpy(case.episode.actions_T3).float()[None]
    found = unroll(model, stack([case.scene.objects]), tip_13, actions_1T3)
    return ObjectMotion(found.translation_BTN3[0], found.rotation_BTN33[0])


def true_motions(case: Scenario, happened: Episode) -> ObjectMotion:
    """What the simulator did to the perceived objects; those that stand for none stay."""
    parts = [
        _true_motion(happened, true_i, center_3.double().numpy())
        for true_i, center_3 in zip(case.scene.truth, case.scene.objects.center_N3, strict=True)
    ]
    steps = len(happened.actions_T3)
    translation = np.stack([each[0] for each in parts], 1) if parts else np.zeros((steps, 0, 3))
    rotation = np.stack([each[1] for each in parts], 1) if parts else np.zeros((steps, 0, 3, 3))
    return ObjectMotion(torch.from_numpy(translation).float(), torch.from_numpy(rotation).float())


def _true_motion(happened: Episode, true_i: int, center_3: Floats) -> tuple[Floats, Floats]:
    steps = len(happened.actions_T3)
    if true_i < 0:
        return np.zeros((steps, 3)), np.tile(np.eye(3), (steps, 1, 1))
    return true_motion(happened.steps, true_i, center_3)
