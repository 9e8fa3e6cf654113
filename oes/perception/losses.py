"""What perception is trained for: one dictionary of loss terms per batch; the weights live in
params.
"""

from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.geom.boxes import iou
from oes.geom.voxels import voxelize
from oes.perception.detector import box_deltas, detection_losses
from oes.perception.lift import Views
from oes.perception.network import PerceptionNet, SceneFeatures
from oes.perception.roi import RoiOutput
from oes.training.precision import half_precision

LOSS_TERMS = ("objectness", "box", "occupancy", "roi_box", "roi_score", "mask", "view")
PROPOSAL_MATCH_M = 0.04
EPSILON = 1e-6


@dataclass(frozen=True)
class PerceptionBatch:
    """B training samples. ``solid_BNP3``: points filling each object (NaN where ``valid_BN`` is
    False).

    ``region_center_BN3`` and ``region_size_BN3``: the true boxes, jittered (anywhere on the table
    where there is no object). The query camera is none of ``views``.
    """

    views: Views
    query: Views
    center_BN3: Tensor
    size_BN3: Tensor
    valid_BN: Tensor
    solid_BNP3: Tensor
    region_center_BN3: Tensor
    region_size_BN3: Tensor

    def to(self, device: torch.device | str) -> "PerceptionBatch":
        """The same batch on another device."""
        return replace(self, **{name: value.to(device) for name, value in vars(self).items()})


def losses(
    net: PerceptionNet, batch: PerceptionBatch, num_proposals: int, num_rendered: int
) -> dict[str, Tensor]:
    """The terms of ``LOSS_TERMS``. ``num_proposals`` of the net's own boxes join the jittered true
    ones in the second stage; the first ``num_rendered`` scenes are rendered into the query
    camera.
    """
    with half_precision(batch.center_BN3.device):
        scene = net.encode(batch.views)
        boxes = (batch.center_BN3, batch.size_BN3, batch.valid_BN)
        terms = detection_losses(
            net.cfg.detector, scene.objectness_BXYZ, scene.deltas_B6XYZ, net.voxels, boxes
        )
        solid = voxelize(batch.solid_BNP3.flatten(1, 2), net.cfg.grid)
        terms["occupancy"] = mask_loss(net.occupancy(scene.coarse_BCXYZ), solid)
        terms |= _region_losses(net, scene, batch, num_proposals)
        terms["view"] = _view_loss(net, scene, batch, num_rendered)
    return terms


def mask_loss(logits_BXYZ: Tensor, solid_BXYZ: Tensor) -> Tensor:
    """Binary cross-entropy plus (1 - soft Dice) per volume, averaged; the former alone ignores
    small objects.
    """
    target = solid_BXYZ.float()
    bce = F.binary_cross_entropy_with_logits(logits_BXYZ, target, reduction="none").flatten(1)
    guess, target = logits_BXYZ.sigmoid().flatten(1), target.flatten(1)
    dice = 1 - (2 * (guess * target).sum(1) + 1) / (guess.sum(1) + target.sum(1) + 1)
    per_object = bce.sum(1) / target.sum(1).clamp(min=100)
    return (per_object + dice).mean() if len(logits_BXYZ) else logits_BXYZ.sum()


def _region_losses(
    net: PerceptionNet, scene: SceneFeatures, batch: PerceptionBatch, num_proposals: int
) -> dict[str, Tensor]:
    """``roi_box`` and ``mask`` over regions with an object, ``roi_score`` (its target: the IoU
    reached) over all.
    """
    with torch.no_grad():
        found = net.proposals(scene, num_proposals)
    centers = torch.cat([batch.region_center_BN3, found[0]], dim=1)
    sizes = torch.cat([batch.region_size_BN3, found[1]], dim=1)
    output = net.regions(scene, (centers, sizes))
    distance = (centers[:, :, None] - batch.center_BN3[:, None]).norm(dim=-1)
    distance = distance.masked_fill(~batch.valid_BN[:, None], torch.inf)
    nearest = distance.min(dim=-1)
    batch_i, region_i = (nearest.values < PROPOSAL_MATCH_M).nonzero(as_tuple=True)
    object_i = nearest.indices[batch_i, region_i]
    true = (batch.center_BN3[batch_i, object_i], batch.size_BN3[batch_i, object_i])
    chosen = (centers[batch_i, region_i], sizes[batch_i, region_i])
    solid = voxelize(batch.solid_BNP3[batch_i, object_i] - chosen[0][:, None], net.roi.window)
    return {
        "roi_box": _box_loss(net, output.deltas_BK6[batch_i, region_i], chosen, true),
        "mask": mask_loss(output.mask_BKXYZ[batch_i, region_i], solid),
        "roi_score": _score_loss(net, output, (centers, sizes), true, (batch_i, region_i)),
    }


def _box_loss(
    net: PerceptionNet, deltas: Tensor, boxes: tuple[Tensor, Tensor], true: tuple[Tensor, Tensor]
) -> Tensor:
    wanted = box_deltas(*boxes, *true, net.cfg.detector.anchor_m)
    return F.smooth_l1_loss(deltas, wanted, beta=0.05, reduction="sum") / max(len(deltas), 1)


def _score_loss(
    net: PerceptionNet,
    output: RoiOutput,
    boxes: tuple[Tensor, Tensor],
    true: tuple[Tensor, Tensor],
    matched: tuple[Tensor, Tensor],
) -> Tensor:
    """Cross-entropy of every region's score against the IoU of its refined box with the object, 0
    without one.
    """
    with torch.no_grad():
        centers, sizes = net.refined(boxes, output)
        target = torch.zeros_like(output.score_BK)
        target[matched] = iou(centers[matched], sizes[matched], *true)
    return F.binary_cross_entropy_with_logits(output.score_BK, target)


def _view_loss(
    net: PerceptionNet, scene: SceneFeatures, batch: PerceptionBatch, count: int
) -> Tensor:
    """Mean absolute error of the predicted query images plus the mean of their root mean square
    errors, RGB in [0, 1].

    The latter is what PSNR sees; alone it would blur what a single view cannot know.
    """
    few = scene.first(count)
    true = batch.query.rgb_BVHW3[:count, 0]
    size = (true.shape[1], true.shape[2])
    guess = net.render(
        few, batch.query.K_BV33[:count, 0], batch.query.world_T_cam_BV44[:count, 0], size
    )
    error = (guess - true).flatten(1)
    return error.abs().mean() + (error.square().mean(1) + EPSILON).sqrt().mean()
