"""Unrolling a one-step model over a sequence of actions (paper section 3.2)."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import roma
import torch
from torch import Tensor, nn

from oes.dynamics.graph import Motion, ObjectState
from oes.objects import Objects


class Model(ABC, nn.Module):
    """A one-step forecaster: appearance once, from the first frame, then one call a step."""

    @abstractmethod
    def appearance(self, objects: Objects) -> Tensor:
        """Appearance BNC of batched objects as first seen; C may be 0."""

    @abstractmethod
    def forward(self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor) -> Motion:
        """Motion of every object while the tip goes from ``tip_world_B3`` by ``action_B3`` (metres)."""


@dataclass(frozen=True)
class Unrolled:
    """Motion of N objects since t = 0 after each of T actions, in world axes.

    ``translation_BTN3`` is the displacement (metres) of the reference point, the box centre at t = 0;
    ``rotation_BTN33`` the rotation about it: x goes to rotation (x - center) + center + translation.
    """

    translation_BTN3: Tensor
    rotation_BTN33: Tensor


def at_rest(center_BN3: Tensor, valid_BN: Tensor) -> ObjectState:
    """The state at t = 0: nothing has moved."""
    eye = torch.eye(3, dtype=center_BN3.dtype, device=center_BN3.device).expand(*center_BN3.shape, 3)
    zero = torch.zeros_like(center_BN3)
    return ObjectState(center_BN3, zero, zero, zero, eye, valid_BN)


def advance(state: ObjectState, motion: Motion) -> ObjectState:
    """The state after one step; rotations multiply from the left, in world axes."""
    return ObjectState(
        center_BN3=state.center_BN3 + motion.dp_BN3,
        velocity_BN3=motion.dp_BN3,
        spin_BN3=motion.spin_BN3,
        moved_BN3=state.moved_BN3 + motion.dp_BN3,
        turned_BN33=roma.rotvec_to_rotmat(motion.spin_BN3) @ state.turned_BN33,
        valid_BN=state.valid_BN,
    )


def unroll(model: Model, objects: Objects, tip_B3: Tensor, actions_BT3: Tensor) -> Unrolled:
    """Forecast batched ``objects`` under ``actions_BT3`` (metres) of the tip, which follows its commanded path."""
    state = at_rest(objects.center_N3, objects.valid_N)
    if not state.valid_BN.shape[1]:  # networks cannot look at nothing
        none = (*actions_BT3.shape[:2], 0, 3)
        return Unrolled(actions_BT3.new_zeros(none), actions_BT3.new_zeros(*none, 3))
    return unroll_from(model, model.appearance(objects), state, tip_B3, actions_BT3)


def unroll_from(
    model: Model, appearance_BNC: Tensor, state: ObjectState, tip_B3: Tensor, actions_BT3: Tensor
) -> Unrolled:
    """As ``unroll``, from any state and a given appearance: a planner computes it once, expanded over its plans."""
    assert actions_BT3.ndim == 3 and actions_BT3.shape[0] == appearance_BNC.shape[0], actions_BT3.shape
    translations, rotations = [], []
    for action_B3 in actions_BT3.unbind(1):
        state = advance(state, model(appearance_BNC, state, tip_B3, action_B3))
        tip_B3 = tip_B3 + action_B3
        translations.append(state.moved_BN3)
        rotations.append(state.turned_BN33)
    return Unrolled(torch.stack(translations, 1), torch.stack(rotations, 1))
