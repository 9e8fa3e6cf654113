"""Dense detector: an objectness and one box per coarse voxel (paper C.1, one anchor)."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.boxes import iou
from oes.perception.blocks import stem

BOX_CHANNELS = 6
PRIOR_LOGIT = 4.0  # negative logit of the prior: objects fill few voxels (RetinaNet, section 4.1)
MIN_TARGET = 0.3  # of the heatmap, for a voxel to be trained to predict the box


@params
class DetectorConfig:
    """Dense detector and selection of the final boxes.

    ``anchor_m``: unit of offsets and sizes. ``sigma_m``: of the Gaussian heatmap target.
    ``num_peaks``: proposals per scene. Final boxes have a score of at least ``min_score`` and
    overlap by at most ``max_iou``.
    """

    channels: int
    anchor_m: float
    sigma_m: float
    num_peaks: int
    min_score: float
    max_iou: float


class DetectorHead(nn.Module):
    """Maps coarse features BCXYZ to objectness logits BXYZ and box deltas B6XYZ."""

    def __init__(self, inputs: int, cfg: DetectorConfig) -> None:
        super().__init__()
        self.cfg = cfg
        hidden = stem(inputs, cfg.channels)
        self.layers = nn.Sequential(hidden, nn.Conv3d(cfg.channels, 1 + BOX_CHANNELS, 1))

    def forward(self, coarse_BCXYZ: Tensor) -> tuple[Tensor, Tensor]:
        """Logits and deltas in float32."""
        out = self.layers(coarse_BCXYZ).float()
        return out[:, 0] - PRIOR_LOGIT, out[:, 1:]


def apply_deltas(
    centers: Tensor, sizes: Tensor | float, deltas: Tensor, unit_m: float
) -> tuple[Tensor, Tensor]:
    """Boxes (centres ...3, sizes ...3) moved by deltas ...6: offset in ``unit_m``, log scale."""
    # The clamp keeps an untrained network from boxes of infinite size.
    return centers + deltas[..., :3] * unit_m, sizes * deltas[..., 3:].clamp(-3, 3).exp()


def box_deltas(
    centers: Tensor, sizes: Tensor | float, to_centers: Tensor, to_sizes: Tensor, unit_m: float
) -> Tensor:
    """Inverse of ``apply_deltas``: deltas ...6 from the first boxes to the second."""
    log_scale = (to_sizes / sizes).clamp(min=1e-3).log()
    return torch.cat([(to_centers - centers) / unit_m, log_scale], dim=-1)


def detection_losses(
    cfg: DetectorConfig,
    logits_BXYZ: Tensor,
    deltas_B6XYZ: Tensor,
    voxels_XYZ3: Tensor,
    boxes: tuple[Tensor, Tensor, Tensor],
) -> dict[str, Tensor]:
    """``objectness``: focal loss per object; ``box``: smooth L1 loss of voxels near centres.

    The target of the objectness is a Gaussian around the nearest centre. ``boxes``: ground-truth
    centres BN3, sizes BN3 and ``valid_BN``.
    """
    centers_BN3, sizes_BN3, valid_BN = boxes
    offsets = voxels_XYZ3[None, None] - centers_BN3[:, :, None, None, None]
    heatmap_BNXYZ = (-offsets.square().sum(-1) / (2 * cfg.sigma_m**2)).exp()
    target, nearest = (heatmap_BNXYZ * valid_BN[..., None, None, None]).max(dim=1)
    # Quality focal loss (Li et al. 2020): nearly all voxels are easy negatives.
    focal = (target - logits_BXYZ.sigmoid()).square().detach()
    bce = F.binary_cross_entropy_with_logits(logits_BXYZ, target, reduction="none")
    batch_i, x, y, z = (target > MIN_TARGET).nonzero(as_tuple=True)
    i = batch_i, nearest[batch_i, x, y, z]
    voxels = voxels_XYZ3[x, y, z]
    target_deltas = box_deltas(voxels, cfg.anchor_m, centers_BN3[i], sizes_BN3[i], cfg.anchor_m)
    deltas = deltas_B6XYZ[batch_i, :, x, y, z]
    error = F.smooth_l1_loss(deltas, target_deltas, beta=0.1, reduction="none").sum(-1)
    weight = target[batch_i, x, y, z]
    return {
        "objectness": (focal * bce).sum() / valid_BN.sum().clamp(min=1),
        "box": (error * weight).sum() / weight.sum().clamp(min=1e-6),
    }


def top_peaks(
    cfg: DetectorConfig, logits_BXYZ: Tensor, deltas_B6XYZ: Tensor, voxels_XYZ3: Tensor, count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """The ``count`` best local maxima: centres BN3, sizes BN3, scores BN (0 past the last peak)."""
    scores = logits_BXYZ.sigmoid()
    # Max-pooling stands for non-maximum suppression (CenterNet, Zhou et al. 2019).
    is_peak = F.max_pool3d(scores[:, None], 3, stride=1, padding=1)[:, 0] == scores
    best = (scores * is_peak).flatten(1).topk(count)
    index = best.indices[:, None].expand(-1, BOX_CHANNELS, -1)
    deltas = deltas_B6XYZ.flatten(2).gather(2, index).transpose(1, 2)
    voxels = voxels_XYZ3.reshape(-1, 3)[best.indices]
    return *apply_deltas(voxels, cfg.anchor_m, deltas, cfg.anchor_m), best.values


def nms_3d(centers_N3: Tensor, sizes_N3: Tensor, scores_N: Tensor, max_iou: float) -> Tensor:
    """Indices of the boxes kept by greedy non-maximum suppression, best score first."""
    overlap = iou(centers_N3[:, None], sizes_N3[:, None], centers_N3[None], sizes_N3[None])
    kept: list[int] = []
    # A stable order makes ties independent of the device.
    for i in scores_N.argsort(descending=True, stable=True).tolist():
        if all(overlap[i, k] <= max_iou for k in kept):
            kept.append(i)
    return torch.tensor(kept, dtype=torch.long, device=scores_N.device)
