"""The detector: training targets, peaks, non-maximum suppression and matching."""

import numpy as np
import torch

from oes.geom.voxels import centers
from oes.perception.detector import (
    DetectorConfig,
    apply_deltas,
    box_deltas,
    detection_losses,
    nms_3d,
    top_peaks,
)
from oes.perception.evaluate import match_detections
from tests.perception_scenes import GRID

CFG = DetectorConfig(
    channels=8, anchor_m=0.12, sigma_m=0.02, num_peaks=4, min_score=0.3, max_iou=0.25
)
VOXELS = centers(GRID.halved())


def test_nms_keeps_the_best_of_overlapping_boxes_and_accepts_no_boxes() -> None:
    boxes = torch.tensor([[0.0, 0, 0], [0.01, 0, 0], [0.2, 0, 0], [0.075, 0, 0]])
    kept = nms_3d(boxes, torch.full((4, 3), 0.1), torch.tensor([0.6, 0.9, 0.5, 0.7]), max_iou=0.25)
    assert kept.tolist() == [1, 3, 2]
    assert nms_3d(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0), 0.2).tolist() == []


def test_apply_deltas_inverts_box_deltas() -> None:
    center, size, to_center, to_size = torch.rand(4, 5, 3) * 0.2 + 0.05
    deltas = box_deltas(center, size, to_center, to_size, 0.12)
    result = apply_deltas(center, size, deltas, 0.12)
    torch.testing.assert_close(result[0], to_center)
    torch.testing.assert_close(result[1], to_size)


def test_ideal_dense_output_has_its_peaks_at_the_objects_and_almost_no_loss() -> None:
    true = (
        torch.tensor([[[0.103, -0.052, 0.044], [-0.124, 0.105, 0.033]]]),
        torch.tensor([[[0.1, 0.06, 0.08], [0.2, 0.1, 0.06]]]),
    )
    distance = (VOXELS[None] - true[0][0][:, None, None, None]).square().sum(-1)
    heatmap = (-distance / (2 * CFG.sigma_m**2)).exp().clamp(1e-6, 1 - 1e-6)
    nearest = heatmap.argmax(0)
    target = box_deltas(
        VOXELS, CFG.anchor_m, true[0][0][nearest], true[1][0][nearest], CFG.anchor_m
    )
    deltas = target.movedim(-1, 0)[None]
    logits = torch.logit(heatmap.amax(0))[None]
    peaks, sizes, scores = top_peaks(CFG, logits, deltas, VOXELS, 2)
    order = peaks[0, :, 0].argsort(descending=True)
    torch.testing.assert_close(peaks[0, order], true[0][0], atol=1e-4, rtol=0)
    torch.testing.assert_close(sizes[0, order], true[1][0], atol=1e-4, rtol=0)
    assert scores.min() > 0.5
    terms = detection_losses(
        CFG, logits, deltas, VOXELS, (*true, torch.ones(1, 2, dtype=torch.bool))
    )
    assert terms["objectness"] < 1e-3 and terms["box"] < 1e-3


def test_a_scene_without_objects_has_a_finite_loss() -> None:
    logits = torch.full((1, *VOXELS.shape[:3]), -3.0, requires_grad=True)
    boxes = torch.zeros(1, 1, 3), torch.ones(1, 1, 3), torch.zeros(1, 1, dtype=torch.bool)
    terms = detection_losses(CFG, logits, torch.zeros(1, 6, *VOXELS.shape[:3]), VOXELS, boxes)
    assert terms["box"] == 0 and torch.isfinite(terms["objectness"])


def test_matching_is_one_to_one_within_a_distance() -> None:
    true = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    detected = np.array([[0.04, 0, 0], [0.01, 0, 0], [0.3, 0, 0]])
    assert match_detections(detected, true).tolist() == [-1, 0, -1]
    assert match_detections(np.array([[0.045, 0, 0], [0.01, 0, 0]]), true).tolist() == [1, 0]
    nothing = np.zeros((0, 3))
    assert match_detections(nothing, true).tolist() == []
    assert match_detections(detected, nothing).tolist() == [-1, -1, -1]
