"""Training examples: perceived objects of an episode's first frame and their true motion."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from oes.dynamics.augment import DynamicsBatch
from oes.episode import Episode, Floats, Step
from oes.objects import Objects, map_tensors

Perceived = tuple[Objects, Sequence[int], int]
"""Unbatched objects of an observation, the true object of each, and the episode's index."""


@dataclass(frozen=True)
class Examples:
    """U observations (one episode perceived under one setting) and their futures, as one batch.

    ``episode_U``: index of the observation's episode in its split.
    """

    all: DynamicsBatch
    episode_U: Tensor

    def batch(self, i_B: Tensor) -> DynamicsBatch:
        """The chosen observations in float32."""
        batch = map_tensors(self.all, lambda x_U: x_U[i_B])
        return replace(batch, objects=batch.objects.to(torch.float32))

    def split(self, validation_share: float) -> tuple[Tensor, Tensor]:
        """Indices of training and of validation observations; no episode is in both."""
        if not 0 < validation_share < 1:
            raise ValueError(f"validation_share must be between 0 and 1, not {validation_share}")
        episodes = torch.unique(self.episode_U)
        num_validation = max(1, round(validation_share * len(episodes)))
        # A fixed seed: all models are validated on the same episodes.
        is_validation = np.random.default_rng(0).permutation(len(episodes)) < num_validation
        validation_U = torch.isin(self.episode_U, episodes[torch.from_numpy(is_validation)])
        return (~validation_U).nonzero()[:, 0], validation_U.nonzero()[:, 0]


def make_examples(perceived: Sequence[Perceived], episodes: Mapping[int, Episode]) -> Examples:
    """Join observations, all of whose objects have a true one, with their episodes."""
    num = max(len(truth) for _, truth, _ in perceived)
    recorded = [episodes[episode_i] for *_, episode_i in perceived]
    futures = [
        _future(episode, objects, truth, num)
        for episode, (objects, truth, _) in zip(recorded, perceived, strict=True)
    ]
    batch = DynamicsBatch(
        objects=stack([padded(objects, num) for objects, *_ in perceived]),
        tip_B3=_tensor([episode.steps[0].tip_world_3 for episode in recorded]),
        actions_BT3=_tensor([episode.actions_T3 for episode in recorded]),
        translation_BTN3=_tensor([translation_TN3 for translation_TN3, _ in futures]),
        rotation_BTN33=_tensor([rotation_TN33 for _, rotation_TN33 in futures]),
    )
    return Examples(batch, torch.tensor([episode_i for *_, episode_i in perceived]))


def true_motion(steps: Sequence[Step], object_i: int, center_3: Floats) -> tuple[Floats, Floats]:
    """Translation T3 (metres) and rotation T33 since the first step, in world axes.

    They are of a point fixed to object ``object_i`` that is first at ``center_3``, which need not
    be the object's origin.
    """
    world_T_obj_I44 = np.stack([step.world_T_obj_N44[object_i] for step in steps])
    now_T_first = world_T_obj_I44[1:] @ np.linalg.inv(world_T_obj_I44[0])
    position_T3 = now_T_first[:, :3, :3] @ center_3 + now_T_first[:, :3, 3]
    return position_T3 - center_3, now_T_first[:, :3, :3]


def padded(objects: Objects, num: int) -> Objects:
    """Unbatched objects filled up to ``num`` with zeros (``valid_N`` False)."""
    missing = num - len(objects.valid_N)
    return map_tensors(objects, lambda x: torch.cat([x, x.new_zeros(missing, *x.shape[1:])]))


def stack(scenes: Sequence[Objects]) -> Objects:
    """Unbatched objects of equal number as one batch."""
    return map_tensors(scenes[0], lambda *x: torch.stack(x), *scenes[1:])


def _future(
    episode: Episode, objects: Objects, truth: Sequence[int], num: int
) -> tuple[Floats, Floats]:
    """True motion TN3, TN33 of the perceived reference points; padding stays at rest."""
    steps = len(episode.actions_T3)
    translation, rotation = np.zeros((steps, num, 3)), np.tile(np.eye(3), (steps, num, 1, 1))
    for i, object_i in enumerate(truth):
        center_3 = objects.center_N3[i].double().numpy()
        translation[:, i], rotation[:, i] = true_motion(episode.steps, object_i, center_3)
    return translation, rotation


def _tensor(arrays: Sequence[Floats]) -> Tensor:
    return torch.from_numpy(np.stack(arrays)).float()
