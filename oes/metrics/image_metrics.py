"""How alike two pictures are."""

from torch import Tensor
from torchmetrics.functional.image import (
    peak_signal_noise_ratio,
    structural_similarity_index_measure,
)


def image_quality(made_3HW: Tensor, true_3HW: Tensor) -> dict[str, float]:
    """``psnr_db`` and ``ssim`` of a picture against the true one, both 0 to 1 (the first is cut off
    there).
    """
    made, true = made_3HW[None].clamp(0, 1), true_3HW[None]
    ssim = structural_similarity_index_measure(made, true, data_range=1.0)
    assert isinstance(ssim, Tensor)
    return {
        "psnr_db": float(peak_signal_noise_ratio(made, true, data_range=1.0)),
        "ssim": float(ssim),
    }
