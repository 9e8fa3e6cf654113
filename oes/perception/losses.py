"""Loss terms of perception for one batch; their weights are in params.yaml."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.geom.boxes import iou
from oes.geom.voxels import voxelize
from oes.objects import map_tensors
from oes.perception.detector import box_deltas, detection_losses
from oes.perception.lift import Views
from oes.perception.network import PerceptionNet, SceneFeatures
from oes.training.precision import half_precision

LOSS_TERMS = ("objectness", "box", "occupancy", "roi_box", "roi_score", "mask", "view")
PROPOSAL_MATCH_M = 0.04
MIN_OCCUPIED = 100  # voxels, in the normalization of the cross-entropy of a volume
EPSILON = 1e-6


@dataclass(frozen=True)
class PerceptionBatch:
    """B training samples of up to N objects; the query camera is none of ``views``.

    ``object_points_BNP3``: points filling each object (NaN where ``valid_BN`` is False).
    ``region_center_BN3``, ``region_size_BN3``: jittered ground-truth boxes (a box on the table
    where ``valid_BN`` is False).
    """

    views: Views
    query: Views
    center_BN3: Tensor
    size_BN3: Tensor
    valid_BN: Tensor
    object_points_BNP3: Tensor
    region_center_BN3: Tensor
    region_size_BN3: Tensor


def losses(
    net: PerceptionNet, batch: PerceptionBatch, num_proposals: int, num_rendered: int
) -> dict[str, Tensor]:
    """The terms of ``LOSS_TERMS``.

    ``num_proposals`` boxes of the network join the jittered ground truth in the second stage; the
    first ``num_rendered`` scenes are rendered into the query camera.
    """
    with half_precision(batch.center_BN3.device):
        scene = net.encode(batch.views)
        boxes = (batch.center_BN3, batch.size_BN3, batch.valid_BN)
        terms = detection_losses(
            net.cfg.detector, scene.objectness_BXYZ, scene.deltas_B6XYZ, net.voxels, boxes
        )
        occupied_BXYZ = voxelize(batch.object_points_BNP3.flatten(1, 2), net.cfg.grid)
        terms["occupancy"] = mask_loss(net.occupancy(scene.coarse_BCXYZ), occupied_BXYZ)
        terms |= _region_losses(net, scene, batch, num_proposals)
        terms["view"] = _view_loss(net, scene, batch, num_rendered)
    return terms


def mask_loss(logits_BXYZ: Tensor, occupied_BXYZ: Tensor) -> Tensor:
    """Binary cross-entropy plus (1 - soft Dice), averaged over the volumes."""
    target = occupied_BXYZ.float()
    bce = F.binary_cross_entropy_with_logits(logits_BXYZ, target, reduction="none").flatten(1)
    predicted, target = logits_BXYZ.sigmoid().flatten(1), target.flatten(1)
    # Cross-entropy alone ignores objects of a few voxels; Dice is relative to their size.
    dice = 1 - (2 * (predicted * target).sum(1) + 1) / (predicted.sum(1) + target.sum(1) + 1)
    bce = bce.sum(1) / target.sum(1).clamp(min=MIN_OCCUPIED)
    # The sum over no volumes is a zero that keeps the graph; their mean would be NaN.
    return (bce + dice).mean() if len(logits_BXYZ) else logits_BXYZ.sum()


def _region_losses(
    net: PerceptionNet, scene: SceneFeatures, batch: PerceptionBatch, num_proposals: int
) -> dict[str, Tensor]:
    """``roi_box`` and ``mask`` of regions with an object; ``roi_score`` of all regions."""
    with torch.no_grad():
        proposals = net.proposals(scene, num_proposals)
    centers = torch.cat([batch.region_center_BN3, proposals[0]], dim=1)
    sizes = torch.cat([batch.region_size_BN3, proposals[1]], dim=1)
    output = net.regions(scene, (centers, sizes))
    distance = (centers[:, :, None] - batch.center_BN3[:, None]).norm(dim=-1)
    nearest = distance.masked_fill(~batch.valid_BN[:, None], torch.inf).min(dim=-1)
    matched = (nearest.values < PROPOSAL_MATCH_M).nonzero(as_tuple=True)
    objects = matched[0], nearest.indices[matched]
    gt = (batch.center_BN3[objects], batch.size_BN3[objects])
    regions = (centers[matched], sizes[matched])
    occupied = voxelize(batch.object_points_BNP3[objects] - regions[0][:, None], net.roi.window)
    target = box_deltas(*regions, *gt, net.cfg.detector.anchor_m)
    deltas = output.deltas_BN6[matched]
    box_error = F.smooth_l1_loss(deltas, target, beta=0.05, reduction="sum")
    with torch.no_grad():
        # The score learns the IoU of the refined box (IoU-Net, Jiang et al. 2018); 0: no object.
        refined = net.refined((centers, sizes), output)
        target_iou = torch.zeros_like(output.score_BN)
        target_iou[matched] = iou(refined[0][matched], refined[1][matched], *gt)
    return {
        "roi_box": box_error / max(len(deltas), 1),
        "mask": mask_loss(output.mask_BNXYZ[matched], occupied),
        "roi_score": F.binary_cross_entropy_with_logits(output.score_BN, target_iou),
    }


def _view_loss(
    net: PerceptionNet, scene: SceneFeatures, batch: PerceptionBatch, count: int
) -> Tensor:
    """Mean absolute error of predicted query images plus the mean of their RMS errors."""
    scene = map_tensors(scene, lambda x: x[:count])
    query = map_tensors(batch.query, lambda x: x[:count])
    gt = query.rgb_BVHW3[:, 0]
    size = (gt.shape[1], gt.shape[2])
    camera = query.K_BV33[:, 0], query.world_T_cam_BV44[:, 0]
    error = (net.render(scene, *camera, size) - gt).flatten(1)
    # PSNR measures the squared error; alone it would blur regions that no input view shows.
    return error.abs().mean() + (error.square().mean(1) + EPSILON).sqrt().mean()
