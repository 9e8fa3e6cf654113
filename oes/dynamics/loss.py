"""The training loss, and the errors watched beside it (paper appendix C.1)."""

from torch import Tensor

from oes.dynamics.augment import DynamicsBatch
from oes.dynamics.unroll import Rollout

WATCHED_STEPS = (1, 3, 5)


def loss_terms(
    found: Rollout, batch: DynamicsBatch, unit_m: float, soft: float
) -> dict[str, Tensor]:
    """Means over valid objects and steps: ``translation`` |p' - p| / unit, ``rotation`` |R' - R|_F
    / (2 sqrt 2).

    The latter is sin(angle / 2): within 4% of the paper's quaternion distance 2 sin(angle / 4) up
    to 60 degrees, and free of its double cover. Errors well below ``soft`` (above 0) count by their
    square: where most objects stay as they are, a distance alone holds every forecast at rest.
    """
    apart = (found.translation_BTN3 - batch.translation_BTN3) / unit_m
    turned = (found.rotation_BTN33 - batch.rotation_BTN33).flatten(-2) / 8**0.5
    return {
        "translation": _mean(_norm(apart, soft), batch),
        "rotation": _mean(_norm(turned, soft), batch),
    }


def errors(found: Rollout, batch: DynamicsBatch) -> dict[str, float]:
    """Mean errors of the valid objects at T = 1, 3, 5, those there are: ``mm_1``, ``deg_1``,
    ``mm_3``, ...
    """
    apart_BTN = (found.translation_BTN3 - batch.translation_BTN3).norm(dim=-1)
    chord_BTN = (found.rotation_BTN33 - batch.rotation_BTN33).flatten(-2).norm(dim=-1)
    angle_BTN = 2 * (chord_BTN / 8**0.5).clamp(max=1).asin()
    valid_BN = batch.objects.valid_N
    out = {}
    for T in (T for T in WATCHED_STEPS if T <= apart_BTN.shape[1]):
        out[f"mm_{T}"] = float(apart_BTN[:, T - 1][valid_BN].mean()) * 1e3
        out[f"deg_{T}"] = float(angle_BTN[:, T - 1][valid_BN].mean().rad2deg())
    return out


def _mean(error_BTN: Tensor, batch: DynamicsBatch) -> Tensor:
    """Mean over the valid objects and all steps."""
    valid_BTN = batch.objects.valid_N[:, None].expand_as(error_BTN)
    return (error_BTN * valid_BTN).sum() / valid_BTN.sum()


def _norm(x: Tensor, soft: float) -> Tensor:
    """Euclidean norm of the last axis, rounded off below ``soft``."""
    return (x.square().sum(-1) + soft**2).sqrt() - soft
