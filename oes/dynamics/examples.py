"""Training examples: perceived objects of an episode's first frame with the true motion that
followed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from oes.dynamics.augment import DynamicsBatch
from oes.episode import Episode, Floats, Step
from oes.objects import Objects


@dataclass(frozen=True)
class Examples:
    """D draws (an episode seen through some views), all in memory; ``objects`` carries a leading D.

    ``episode_D`` is the position of each draw's episode in its split; ``voxel_m`` the voxel size of
    the crops.
    """

    objects: Objects
    tip_D3: Tensor
    actions_DT3: Tensor
    translation_DTN3: Tensor
    rotation_DTN33: Tensor
    episode_D: Tensor
    voxel_m: float

    def batch(self, draw_B: Tensor) -> DynamicsBatch:
        """The chosen draws in float32."""
        objects = Objects(**{name: value[draw_B] for name, value in vars(self.objects).items()}).to(
            torch.float32
        )
        return DynamicsBatch(
            objects=objects,
            tip_B3=self.tip_D3[draw_B],
            actions_BT3=self.actions_DT3[draw_B],
            translation_BTN3=self.translation_DTN3[draw_B],
            rotation_BTN33=self.rotation_DTN33[draw_B],
        )

    def split(self, held_out: float) -> tuple[Tensor, Tensor]:
        """Draws to train on and draws held out; all draws of an episode fall on the same side."""
        if not 0 < held_out < 1:
            raise ValueError(f"held_out must lie between 0 and 1, not {held_out}")
        episodes = torch.unique(self.episode_D)
        is_held_E = np.random.default_rng(0).permutation(len(episodes)) < max(
            1, round(held_out * len(episodes))
        )
        is_held_D = torch.isin(self.episode_D, episodes[torch.from_numpy(is_held_E)])
        return (~is_held_D).nonzero()[:, 0], is_held_D.nonzero()[:, 0]


def true_motion(steps: Sequence[Step], object_i: int, center_3: Floats) -> tuple[Floats, Floats]:
    """Translation T3 (metres), rotation T33 since the first step of a point fixed to object
    ``object_i``; world axes.

    ``center_3`` is where the point is at first; it need not be the object's own origin or true
    centre.
    """
    world_T_obj_T44 = np.stack([step.world_T_obj_N44[object_i] for step in steps])
    now_T_first = world_T_obj_T44[1:] @ np.linalg.inv(world_T_obj_T44[0])
    moved_T3 = now_T_first[:, :3, :3] @ center_3 + now_T_first[:, :3, 3]
    return moved_T3 - center_3, now_T_first[:, :3, :3]


def examples(
    scenes: Sequence[tuple[Objects, Sequence[int]]],
    episodes: Sequence[Episode],
    episode_is: Sequence[int],
    voxel_m: float,
) -> Examples:
    """Join perceived scenes (unbatched objects, the true object of each) with what happened in the
    episode of each.

    Every perceived object must have a true one; ``episode_is`` numbers the episodes.
    """
    most = max(len(truth) for _, truth in scenes)
    pairs = list(zip(scenes, episodes, strict=True))
    futures = [_future(episode, objects, truth, most) for (objects, truth), episode in pairs]
    return Examples(
        objects=stack([padded(objects, most) for objects, _ in scenes]),
        tip_D3=_tensor(np.stack([episode.steps[0].tip_world_3 for episode in episodes])),
        actions_DT3=_tensor(np.stack([episode.actions_T3 for episode in episodes])),
        translation_DTN3=_tensor(np.stack([translation for translation, _ in futures])),
        rotation_DTN33=_tensor(np.stack([rotation for _, rotation in futures])),
        episode_D=torch.tensor(episode_is),
        voxel_m=voxel_m,
    )


def padded(objects: Objects, num: int) -> Objects:
    """Unbatched objects filled up with zeros (``valid_N`` False) to ``num``."""
    missing = num - len(objects.valid_N)
    return Objects(
        **{
            name: torch.cat([x, x.new_zeros(missing, *x.shape[1:])])
            for name, x in vars(objects).items()
        }
    )


def stack(scenes: Sequence[Objects]) -> Objects:
    """Unbatched objects of equal number as one batch."""
    return Objects(
        **{
            name: torch.stack([getattr(scene, name) for scene in scenes])
            for name in vars(scenes[0])
        }
    )


def _future(
    episode: Episode, objects: Objects, truth: Sequence[int], most: int
) -> tuple[Floats, Floats]:
    """True motion TN3, TN33 of the perceived reference points, padded with rest."""
    steps = len(episode.actions_T3)
    translation, rotation = np.zeros((steps, most, 3)), np.tile(np.eye(3), (steps, most, 1, 1))
    for i, object_i in enumerate(truth):
        center_3 = objects.center_N3[i].double().numpy()
        translation[:, i], rotation[:, i] = true_motion(episode.steps, object_i, center_3)
    return translation, rotation


def _tensor(x: Floats) -> Tensor:
    return torch.from_numpy(x).float()
