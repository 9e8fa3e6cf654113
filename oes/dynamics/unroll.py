"""Unrolling a one-step model over a sequence of actions (paper section 3.2)."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import roma
import torch
from torch import Tensor, nn

from oes.dynamics.augment import DynamicsBatch
from oes.dynamics.error_model import ErrorModel
from oes.dynamics.graph import ObjectState, StepMotion, TipMotion
from oes.objects import Objects, map_tensors


class DynamicsModel(ABC, nn.Module):
    """One-step forecaster: the first frame is encoded once, then each step is one call."""

    error_model: ErrorModel | None = None

    @property
    def num_samples(self) -> int:
        """Number of sampled futures whose mean is the forecast; 1 for deterministic models."""
        return 1

    def sample(self, appearance_BNC: Tensor) -> Tensor:
        """Appearances of all samples, sample by sample; the first are the objects as perceived."""
        return appearance_BNC

    @abstractmethod
    def appearance(self, objects: Objects) -> Tensor:
        """Appearance BNC of batched objects in the first frame; C may be 0."""

    @abstractmethod
    def forward(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Motion of every object over one action."""


@dataclass(frozen=True)
class Rollout:
    """Motion of N objects since t = 0 after each of T actions, in world axes.

    ``translation_BTN3``: displacement (metres) of the reference point, the box centre at t = 0;
    ``rotation_BTN33``: rotation about it, so that a point x moves to rotation (x - center) +
    center + translation. ``spread_BTN``: standard deviation of the samples' translation (metres);
    ``sigma_BTN``: its calibrated scale of the error (see ``oes.dynamics.error_model``).
    """

    translation_BTN3: Tensor
    rotation_BTN33: Tensor
    sigma_BTN: Tensor | None = None
    spread_BTN: Tensor | None = None


def initial_state(center_BN3: Tensor, valid_BN: Tensor) -> ObjectState:
    """State at t = 0: objects at rest."""
    zero, eye_33 = torch.zeros_like(center_BN3), torch.eye(3).to(center_BN3)
    rotation_BN33 = eye_33.expand(*center_BN3.shape, 3)
    return ObjectState(center_BN3, zero, zero, zero, rotation_BN33, zero, valid_BN)


def advance_state(state: ObjectState, motion: StepMotion) -> ObjectState:
    """State after one step; rotations multiply from the left, in world axes."""
    return ObjectState(
        center_BN3=state.center_BN3 + motion.dp_BN3,
        velocity_BN3=motion.dp_BN3,
        omega_BN3=motion.rotvec_BN3,
        displacement_BN3=state.displacement_BN3 + motion.dp_BN3,
        rotation_BN33=roma.rotvec_to_rotmat(motion.rotvec_BN3) @ state.rotation_BN33,
        twist_BN3=state.twist_BN3 if motion.twist_BN3 is None else motion.twist_BN3,
        valid_BN=state.valid_BN,
    )


def unroll(model: DynamicsModel, objects: Objects, tip_B3: Tensor, actions_BT3: Tensor) -> Rollout:
    """Forecast of batched ``objects``; the tip starts at ``tip_B3`` and moves by each action."""
    state = initial_state(objects.center_N3, objects.valid_N)
    if not state.valid_BN.shape[1]:  # convolutions refuse empty inputs
        empty = (*actions_BT3.shape[:2], 0, 3)
        return Rollout(actions_BT3.new_zeros(empty), actions_BT3.new_zeros(*empty, 3))
    return unroll_mean(model, model.appearance(objects), state, tip_B3, actions_BT3)


def unroll_mean(
    model: DynamicsModel,
    appearance_BNC: Tensor,
    state: ObjectState,
    tip_B3: Tensor,
    actions_BT3: Tensor,
) -> Rollout:
    """Mean of the model's samples from a given appearance and state."""
    count = model.num_samples
    if count == 1:
        return unroll_samples(model, appearance_BNC, state, tip_B3, actions_BT3)
    # Samples are stacked along the batch axis.
    samples = unroll_samples(
        model,
        model.sample(appearance_BNC),
        map_tensors(state, lambda x: torch.cat([x] * count)),
        torch.cat([tip_B3] * count),
        torch.cat([actions_BT3] * count),
    )
    translation_MBTN3 = torch.unflatten(samples.translation_BTN3, 0, (count, -1))
    mean_BTN3 = translation_MBTN3.mean(0)
    spread_BTN = (translation_MBTN3 - mean_BTN3).square().sum(-1).mean(0).sqrt()
    # The mean of rotation matrices is projected back onto the rotations.
    mean_BTN33 = torch.unflatten(samples.rotation_BTN33, 0, (count, -1)).mean(0)
    sigma_BTN = None if model.error_model is None else model.error_model.sigma(spread_BTN)
    return Rollout(mean_BTN3, roma.special_procrustes(mean_BTN33), sigma_BTN, spread_BTN)


def unroll_samples(
    model: DynamicsModel,
    appearance_BNC: Tensor,
    state: ObjectState,
    tip_B3: Tensor,
    actions_BT3: Tensor,
) -> Rollout:
    """One future of each given appearance, without averaging over samples."""
    assert actions_BT3.ndim == 3 and len(actions_BT3) == len(appearance_BNC), actions_BT3.shape
    states = []
    for action_B3 in actions_BT3.unbind(1):
        state = advance_state(state, model(appearance_BNC, state, TipMotion(tip_B3, action_B3)))
        tip_B3 = tip_B3 + action_B3
        states.append(state)
    translation_BTN3 = torch.stack([state.displacement_BN3 for state in states], 1)
    return Rollout(translation_BTN3, torch.stack([state.rotation_BN33 for state in states], 1))


def teacher_forced(model: DynamicsModel, batch: DynamicsBatch) -> Rollout:
    """As ``unroll``, but every step starts at the true state; all steps run as one batch."""
    objects, actions_BT3 = batch.objects, batch.actions_BT3
    steps, first = actions_BT3.shape[1], initial_state(objects.center_N3, objects.valid_N)
    moved_BTN3 = _delayed(batch.translation_BTN3, first.displacement_BN3)
    rotated_BTN33 = _delayed(batch.rotation_BTN33, first.rotation_BN33)
    step_BTN33 = rotated_BTN33 @ _delayed(rotated_BTN33, first.rotation_BN33).mT
    states = ObjectState(
        center_BN3=first.center_BN3[:, None] + moved_BTN3,
        velocity_BN3=moved_BTN3 - _delayed(moved_BTN3, first.displacement_BN3),
        omega_BN3=roma.rotmat_to_rotvec(step_BTN33),
        displacement_BN3=moved_BTN3,
        rotation_BN33=rotated_BTN33,
        twist_BN3=torch.zeros_like(moved_BTN3),
        valid_BN=first.valid_BN[:, None].expand(-1, steps, -1),
    )
    state = map_tensors(states, lambda x_BT: x_BT.flatten(0, 1))
    before_BT3 = _delayed(actions_BT3, torch.zeros_like(batch.tip_B3)).cumsum(1)
    tip_BT3 = batch.tip_B3[:, None] + before_BT3
    tip = TipMotion(tip_BT3.flatten(0, 1), actions_BT3.flatten(0, 1))
    appearance = model.appearance(objects).repeat_interleave(steps, 0)
    after = advance_state(state, model(appearance, state, tip))
    translation_BTN3 = after.displacement_BN3.reshape(moved_BTN3.shape)
    return Rollout(translation_BTN3, after.rotation_BN33.reshape(rotated_BTN33.shape))


def _delayed(x_BT: Tensor, first_B: Tensor) -> Tensor:
    """A sequence one step later, with ``first_B`` in front."""
    return torch.cat([first_B[:, None], x_BT[:, :-1]], 1)
