"""The dense detector: an objectness and one box (paper C.1, one anchor) at every coarse voxel;
targets and losses.
"""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.boxes import iou
from oes.perception.blocks import Stem

BOX_CHANNELS = 6
RARE_LOGIT = 4.0


@params
class DetectorConfig:
    """``anchor_m``: unit of offsets and sizes. ``sigma_m``: width of the Gaussian target around an
    object's centre.

    ``num_peaks`` proposals a scene go to the second stage; what it scores under ``min_score`` is
    dropped, and of two boxes that overlap by more than ``max_iou`` only the better one is kept.
    """

    channels: int
    anchor_m: float
    sigma_m: float
    num_peaks: int
    min_score: float
    max_iou: float


class DetectorHead(nn.Module):
    """Coarse features BCXYZ to objectness logits BXYZ and box deltas B6XYZ (offset and log size, in
    anchors).
    """

    def __init__(self, inputs: int, cfg: DetectorConfig) -> None:
        super().__init__()
        self.cfg = cfg
        self.layers = nn.Sequential(
            Stem(inputs, cfg.channels), nn.Conv3d(cfg.channels, 1 + BOX_CHANNELS, 1)
        )

    def forward(self, coarse_BCXYZ: Tensor) -> tuple[Tensor, Tensor]:
        """Logits and deltas in float32."""
        out = self.layers(coarse_BCXYZ).float()
        return out[:, 0] - RARE_LOGIT, out[:, 1:]


def apply_deltas(
    centers: Tensor, sizes: Tensor | float, deltas: Tensor, unit_m: float
) -> tuple[Tensor, Tensor]:
    """Boxes ...3 moved by ``unit_m`` times the first three deltas and stretched by exp of the last
    three.
    """
    return centers + deltas[..., :3] * unit_m, sizes * deltas[..., 3:].clamp(-3, 3).exp()


def box_deltas(
    centers: Tensor, sizes: Tensor | float, to_centers: Tensor, to_sizes: Tensor, unit_m: float
) -> Tensor:
    """The deltas ...6 that ``apply_deltas`` needs to turn the first boxes into the second."""
    return torch.cat(
        [(to_centers - centers) / unit_m, (to_sizes / sizes).clamp(min=1e-3).log()], dim=-1
    )


def gaussian_heatmap(
    voxels_XYZ3: Tensor, centers_BN3: Tensor, valid_BN: Tensor, sigma_m: float
) -> tuple[Tensor, Tensor]:
    """Gaussian closeness BXYZ of every voxel to the nearest object's centre (0 without objects),
    and which object.
    """
    offsets = voxels_XYZ3[None, None] - centers_BN3[:, :, None, None, None]
    closeness = (-offsets.square().sum(-1) / (2 * sigma_m**2)).exp() * valid_BN[
        ..., None, None, None
    ]
    nearest = closeness.max(dim=1)
    return nearest.values, nearest.indices


def detection_losses(
    cfg: DetectorConfig,
    logits_BXYZ: Tensor,
    deltas_B6XYZ: Tensor,
    voxels_XYZ3: Tensor,
    boxes: tuple[Tensor, Tensor, Tensor],
) -> dict[str, Tensor]:
    """``objectness`` (focal, soft targets) and ``box`` (smooth L1 near centres), a mean over
    objects.

    ``boxes`` holds true centres BN3, sizes BN3 and which of them exist, BN.
    """
    centers_BN3, sizes_BN3, valid_BN = boxes
    target, owner = gaussian_heatmap(voxels_XYZ3, centers_BN3, valid_BN, cfg.sigma_m)
    count = valid_BN.sum().clamp(min=1)
    focal = (target - logits_BXYZ.sigmoid()).square()
    bce = F.binary_cross_entropy_with_logits(logits_BXYZ, target, reduction="none")
    batch_i, x, y, z = (target > 0.3).nonzero(as_tuple=True)
    object_i = owner[batch_i, x, y, z]
    wanted = box_deltas(
        voxels_XYZ3[x, y, z],
        cfg.anchor_m,
        centers_BN3[batch_i, object_i],
        sizes_BN3[batch_i, object_i],
        cfg.anchor_m,
    )
    error = F.smooth_l1_loss(
        deltas_B6XYZ[batch_i, :, x, y, z], wanted, beta=0.1, reduction="none"
    ).sum(-1)
    weight = target[batch_i, x, y, z]
    return {
        "objectness": (focal.detach() * bce).sum() / count,
        "box": (error * weight).sum() / weight.sum().clamp(min=1e-6),
    }


def top_peaks(
    cfg: DetectorConfig, logits_BXYZ: Tensor, deltas_B6XYZ: Tensor, voxels_XYZ3: Tensor, count: int
) -> tuple[Tensor, Tensor, Tensor]:
    """The ``count`` best local maxima: centres BK3, sizes BK3 and scores BK, best first; score 0
    past the last peak.
    """
    scores = logits_BXYZ.sigmoid()
    is_peak = F.max_pool3d(scores[:, None], 3, stride=1, padding=1)[:, 0] == scores
    best = (scores * is_peak).flatten(1).topk(count)
    deltas = (
        deltas_B6XYZ.flatten(2)
        .gather(2, best.indices[:, None].expand(-1, BOX_CHANNELS, -1))
        .transpose(1, 2)
    )
    centers, sizes = apply_deltas(
        voxels_XYZ3.reshape(-1, 3)[best.indices], cfg.anchor_m, deltas, cfg.anchor_m
    )
    return centers, sizes, best.values


def nms_3d(centers_N3: Tensor, sizes_N3: Tensor, scores_N: Tensor, max_iou: float) -> Tensor:
    """Indices of the boxes kept by non-maximum suppression in 3D, best score first; empty in, empty
    out.
    """
    overlap = iou(centers_N3[:, None], sizes_N3[:, None], centers_N3[None], sizes_N3[None])
    kept: list[int] = []
    for candidate in scores_N.argsort(descending=True, stable=True).tolist():
        if all(overlap[candidate, better] <= max_iou for better in kept):
            kept.append(candidate)
    return torch.tensor(kept, dtype=torch.long, device=scores_N.device)
