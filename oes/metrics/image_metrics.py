"""Similarity of images."""

from torch import Tensor
from torchmetrics.functional.image import (
    peak_signal_noise_ratio,
    structural_similarity_index_measure,
)


def image_quality(predicted_3HW: Tensor, true_3HW: Tensor) -> dict[str, float]:
    """``psnr_db`` and ``ssim`` of RGB images in [0, 1]; the prediction is clamped to it."""
    predicted, true = predicted_3HW[None].clamp(0, 1), true_3HW[None]
    ssim = structural_similarity_index_measure(predicted, true, data_range=1.0)
    assert isinstance(ssim, Tensor)
    psnr = peak_signal_noise_ratio(predicted, true, data_range=1.0)
    return {"psnr_db": float(psnr), "ssim": float(ssim)}
