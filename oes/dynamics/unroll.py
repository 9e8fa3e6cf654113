"""Unrolling a one-step model over a sequence of actions (paper section 3.2)."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import roma
import torch
from torch import Tensor, nn

from oes.dynamics.error_model import ErrorModel
from oes.dynamics.graph import ObjectState, StepMotion
from oes.objects import Objects


class DynamicsModel(ABC, nn.Module):
    """A one-step forecaster: appearance once, from the first frame, then one call a step."""

    error_model: ErrorModel | None = None

    @property
    def num_samples(self) -> int:
        """How many futures make up a forecast: 1, but for models that draw what cannot be seen."""
        return 1

    def sample(self, appearance_BNC: Tensor) -> Tensor:
        """Appearances (DB)NC of all that the model draws, draw by draw; the first is of the objects
        as they seem.
        """
        return appearance_BNC

    @abstractmethod
    def appearance(self, objects: Objects) -> Tensor:
        """Appearance BNC of batched objects as first seen; C may be 0."""

    @abstractmethod
    def forward(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """Motion of every object while the tip goes from ``tip_world_B3`` by ``action_B3``
        (metres).
        """


@dataclass(frozen=True)
class Rollout:
    """Motion of N objects since t = 0 after each of T actions, in world axes.

    ``translation_BTN3`` is the displacement (metres) of the reference point, the box centre at t =
    0; ``rotation_BTN33`` the rotation about it: x goes to rotation (x - center) + center +
    translation. ``sigma_BTN``: how far off the translation may be (metres; see
    ``oes.dynamics.error_model``), of models that tell.
    """

    translation_BTN3: Tensor
    rotation_BTN33: Tensor
    sigma_BTN: Tensor | None = None
    spread_BTN: Tensor | None = None


def initial_state(center_BN3: Tensor, valid_BN: Tensor) -> ObjectState:
    """The state at t = 0: nothing has moved."""
    eye = torch.eye(3, dtype=center_BN3.dtype, device=center_BN3.device).expand(
        *center_BN3.shape, 3
    )
    zero = torch.zeros_like(center_BN3)
    return ObjectState(center_BN3, zero, zero, zero, eye, zero, valid_BN)


def advance_state(state: ObjectState, motion: StepMotion) -> ObjectState:
    """The state after one step; rotations multiply from the left, in world axes."""
    return ObjectState(
        center_BN3=state.center_BN3 + motion.dp_BN3,
        velocity_BN3=motion.dp_BN3,
        spin_BN3=motion.spin_BN3,
        moved_BN3=state.moved_BN3 + motion.dp_BN3,
        turned_BN33=roma.rotvec_to_rotmat(motion.spin_BN3) @ state.turned_BN33,
        twist_BN3=state.twist_BN3 if motion.twist_BN3 is None else motion.twist_BN3,
        valid_BN=state.valid_BN,
    )


def unroll(model: DynamicsModel, objects: Objects, tip_B3: Tensor, actions_BT3: Tensor) -> Rollout:
    """Forecast batched ``objects`` under ``actions_BT3`` (metres) of the tip, which follows its
    commanded path.
    """
    state = initial_state(objects.center_N3, objects.valid_N)
    if not state.valid_BN.shape[1]:  # networks cannot look at nothing
        none = (*actions_BT3.shape[:2], 0, 3)
        return Rollout(actions_BT3.new_zeros(none), actions_BT3.new_zeros(*none, 3))
    return unroll_mean(model, model.appearance(objects), state, tip_B3, actions_BT3)


def unroll_mean(
    model: DynamicsModel,
    appearance_BNC: Tensor,
    state: ObjectState,
    tip_B3: Tensor,
    actions_BT3: Tensor,
) -> Rollout:
    """As ``unroll``, from any state and a given appearance: the mean of the model's futures."""
    if model.num_samples == 1:
        return unroll_samples(model, appearance_BNC, state, tip_B3, actions_BT3)
    many = ObjectState(**{name: _repeated(x, model.num_samples) for name, x in vars(state).items()})
    pushes = _repeated(tip_B3, model.num_samples), _repeated(actions_BT3, model.num_samples)
    found = unroll_samples(model, model.sample(appearance_BNC), many, *pushes)
    translation_DBTN3 = found.translation_BTN3.reshape(
        model.num_samples, *actions_BT3.shape[:2], -1, 3
    )
    mean_BTN3 = translation_DBTN3.mean(0)
    spread_BTN = (translation_DBTN3 - mean_BTN3).square().sum(-1).mean(0).sqrt()
    rotation_BTN33 = roma.special_procrustes(
        found.rotation_BTN33.reshape(*translation_DBTN3.shape, 3).mean(0)
    )
    sigma_BTN = None if model.error_model is None else model.error_model.sigma(spread_BTN)
    return Rollout(mean_BTN3, rotation_BTN33, sigma_BTN, spread_BTN)


def unroll_samples(
    model: DynamicsModel,
    appearance_BNC: Tensor,
    state: ObjectState,
    tip_B3: Tensor,
    actions_BT3: Tensor,
) -> Rollout:
    """One future of each appearance: a planner computes those once, expanded over its plans."""
    assert actions_BT3.ndim == 3 and actions_BT3.shape[0] == appearance_BNC.shape[0], (
        actions_BT3.shape
    )
    translations, rotations = [], []
    for action_B3 in actions_BT3.unbind(1):
        state = advance_state(state, model(appearance_BNC, state, tip_B3, action_B3))
        tip_B3 = tip_B3 + action_B3
        translations.append(state.moved_BN3)
        rotations.append(state.turned_BN33)
    return Rollout(torch.stack(translations, 1), torch.stack(rotations, 1))


def teacher_forced(
    model: DynamicsModel,
    objects: Objects,
    tip_B3: Tensor,
    actions_BT3: Tensor,
    translation_BTN3: Tensor,
    rotation_BTN33: Tensor,
) -> Rollout:
    """Each step forecast alone, from the true state before it; motion is still counted since t =
    0.
    """
    steps, first = actions_BT3.shape[1], initial_state(objects.center_N3, objects.valid_N)
    moved_BTN3 = torch.cat([torch.zeros_like(translation_BTN3[:, :1]), translation_BTN3], 1)
    turned_BTN33 = torch.cat([first.turned_BN33[:, None], rotation_BTN33], 1)
    last_BTN3 = torch.cat([moved_BTN3[:, :1], moved_BTN3[:, :-1]], 1)
    last_BTN33 = torch.cat([turned_BTN33[:, :1], turned_BTN33[:, :-1]], 1)
    state = ObjectState(
        center_BN3=(first.center_BN3[:, None] + moved_BTN3)[:, :-1].flatten(0, 1),
        velocity_BN3=(moved_BTN3 - last_BTN3)[:, :-1].flatten(0, 1),
        spin_BN3=roma.rotmat_to_rotvec(turned_BTN33 @ last_BTN33.mT)[:, :-1].flatten(0, 1),
        moved_BN3=moved_BTN3[:, :-1].flatten(0, 1),
        turned_BN33=turned_BTN33[:, :-1].flatten(0, 1),
        twist_BN3=torch.zeros_like(moved_BTN3[:, :-1]).flatten(0, 1),
        valid_BN=first.valid_BN.repeat_interleave(steps, 0),
    )
    appearance_CNC = model.appearance(objects).repeat_interleave(steps, 0)
    tip_BT3 = tip_B3[:, None] + torch.cat(
        [torch.zeros_like(actions_BT3[:, :1]), actions_BT3[:, :-1]], 1
    ).cumsum(1)
    after = advance_state(
        state, model(appearance_CNC, state, tip_BT3.flatten(0, 1), actions_BT3.flatten(0, 1))
    )
    return Rollout(
        after.moved_BN3.reshape(translation_BTN3.shape),
        after.turned_BN33.reshape(rotation_BTN33.shape),
    )


def _repeated(x_B: Tensor, times: int) -> Tensor:
    """So many copies, one after the other."""
    return x_B.repeat(times, *[1] * (x_B.ndim - 1))
