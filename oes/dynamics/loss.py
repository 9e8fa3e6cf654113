"""Training loss and validation errors (paper appendix C.1)."""

from torch import Tensor

from oes.dynamics.augment import DynamicsBatch
from oes.dynamics.unroll import Rollout

VALIDATED_STEPS = (1, 3, 5)


def loss_terms(
    predicted: Rollout, batch: DynamicsBatch, unit_m: float, smoothing: float
) -> dict[str, Tensor]:
    """Mean losses over valid objects and steps: |p' - p| / unit and |R' - R|_F / (2 sqrt 2).

    The rotation term is sin(angle / 2): within 4% of the paper's quaternion distance
    2 sin(angle / 4) up to 60 degrees, without the double cover. Errors well below ``smoothing``
    (> 0) count quadratically: most objects rest, and a norm would hold every forecast at rest.
    """
    translation = (predicted.translation_BTN3 - batch.translation_BTN3) / unit_m
    rotation = (predicted.rotation_BTN33 - batch.rotation_BTN33).flatten(-2) / 8**0.5
    valid_BTN = batch.objects.valid_N[:, None].expand(translation.shape[:-1])

    def mean(x_BTNC: Tensor) -> Tensor:
        # Pseudo-Huber: quadratic near 0, where a norm would have no gradient.
        norm_BTN = (x_BTNC.square().sum(-1) + smoothing**2).sqrt() - smoothing
        return (norm_BTN * valid_BTN).sum() / valid_BTN.sum()

    return {"translation": mean(translation), "rotation": mean(rotation)}


def errors(predicted: Rollout, batch: DynamicsBatch) -> dict[str, float]:
    """Mean errors of valid objects at T = 1, 3, 5, if forecast: ``mm_1``, ``deg_1``, ``mm_3``..."""
    distance_BTN = (predicted.translation_BTN3 - batch.translation_BTN3).norm(dim=-1)
    # The chord |R' - R| determines the angle: exact for small ones, unlike the trace.
    chord_BTN = (predicted.rotation_BTN33 - batch.rotation_BTN33).flatten(-2).norm(dim=-1)
    angle_BTN = 2 * (chord_BTN / 8**0.5).clamp(max=1).asin()
    valid_BN = batch.objects.valid_N
    out = {}
    for T in (T for T in VALIDATED_STEPS if T <= distance_BTN.shape[1]):
        out[f"mm_{T}"] = float(distance_BTN[:, T - 1][valid_BN].mean()) * 1e3
        out[f"deg_{T}"] = float(angle_BTN[:, T - 1][valid_BN].mean().rad2deg())
    return out
