"""Perception network: views -> lifted volume -> 3D U-Net -> scene features, and their heads."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.voxels import Grid, centers, fold_order, unfold
from oes.perception import detector
from oes.perception.blocks import UNet
from oes.perception.decoder import BackgroundField, DecoderConfig, FieldHead, ViewDecoder
from oes.perception.lift import NUM_GEOMETRY, LiftConfig, Views, lift
from oes.perception.rays import Field
from oes.perception.roi import RoiConfig, RoiHead, RoiOutput
from oes.perception.surface import SurfaceHead, SurfaceHeadConfig


@params
class PerceptionNetConfig:
    """``grid``: of the scene map; the U-Net works on 2x2x2 blocks of it.

    ``image_features``: channels of the image encoder besides RGB. ``map_features``: of the scene
    map.
    """

    grid: Grid
    lift: LiftConfig
    image_features: int
    channels: tuple[int, ...]
    blocks: tuple[int, ...]
    map_features: int
    detector: detector.DetectorConfig
    roi: RoiConfig
    decoder: DecoderConfig
    surface: SurfaceHeadConfig


@dataclass(frozen=True)
class SceneFeatures:
    """Encoding of B scenes on blocks of 2x2x2 voxels.

    ``features_BVHWC``: of the pixels, to lift regions. ``lifted_BCXYZ``: input of the U-Net.
    ``coarse_BCXYZ``: its output. ``objectness_BXYZ``, ``deltas_B6XYZ``: of the dense detector.
    """

    views: Views
    features_BVHWC: Tensor
    lifted_BCXYZ: Tensor
    coarse_BCXYZ: Tensor
    objectness_BXYZ: Tensor
    deltas_B6XYZ: Tensor


class ImageEncoder(nn.Module):
    """Two 3x3 convolutions over RGB and depth; RGB itself stays the first three features."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(4, 2 * features, 3, padding=1)
        self.second = nn.Conv2d(2 * features, features, 3, padding=1)

    def forward(self, views: Views) -> Tensor:
        """Features BVHW(3+C) of every pixel."""
        rgbd = torch.cat([views.rgb_BVHW3, views.depth_m_BVHW[..., None]], dim=-1)
        x = F.relu(self.first(rgbd.flatten(0, 1).movedim(-1, 1)))
        x = self.second(x).movedim(1, -1).unflatten(0, rgbd.shape[:2])
        return torch.cat([views.rgb_BVHW3.to(x.dtype), x], dim=-1)


class PerceptionNet(nn.Module):
    """All trained parts: ``encode`` runs once per scene; the other methods read its features."""

    points: Tensor
    voxels: Tensor

    def __init__(self, cfg: PerceptionNetConfig) -> None:
        super().__init__()
        self.cfg, self.coarse_grid = cfg, cfg.grid.halved()
        lifted, width = NUM_GEOMETRY + 3 + cfg.image_features, cfg.channels[0]
        # Derived from the config, so not part of the weights.
        self.register_buffer("points", fold_order(centers(cfg.grid)), persistent=False)
        self.register_buffer("voxels", centers(self.coarse_grid), persistent=False)
        self.image_encoder = ImageEncoder(cfg.image_features)
        self.unet = UNet(8 * lifted + 1, cfg.channels, cfg.blocks)
        self.map = FieldHead(width, lifted, 1, cfg.map_features, self.coarse_grid.shape)
        self.occupancy_head = nn.Conv3d(width, 8, 1)
        self.detector = detector.DetectorHead(width, cfg.detector)
        self.roi = RoiHead(cfg.roi, cfg.lift, lifted, width)
        self.background = BackgroundField(cfg.decoder.background, lifted, cfg.map_features)
        self.decoder = ViewDecoder(cfg.decoder, cfg.map_features)
        self.surface = SurfaceHead(cfg.surface, lifted)

    def encode(self, views: Views) -> SceneFeatures:
        """Encoding of scenes with the same number (at least 1) of views each, in any order."""
        batch, shape = len(views.depth_m_BVHW), self.coarse_grid.shape
        features = self.image_encoder(views)
        points = self.points.reshape(1, -1, 3).expand(batch, -1, -1)
        lifted = lift(self.cfg.lift, views, features, points).reshape(batch, *shape, -1)
        # Only the height is an absolute input: augmentation never shifts or tilts the table plane.
        height = self.voxels[None, ..., 2:].expand(batch, *shape, 1) / self.cfg.detector.anchor_m
        inputs = torch.cat([lifted, height.to(lifted.dtype)], dim=-1).movedim(-1, 1)
        coarse = self.unet(inputs)
        return SceneFeatures(views, features, inputs, coarse, *self.detector(coarse))

    def scene_map(self, scene: SceneFeatures) -> Tensor:
        """The 3D feature map BCXYZ on ``cfg.grid``; channel 0 is a density logit."""
        field: Tensor = self.map(scene.coarse_BCXYZ, scene.lifted_BCXYZ)
        return field

    def occupancy(self, coarse_BCXYZ: Tensor) -> Tensor:
        """Logits BXYZ on ``cfg.grid`` that a voxel is inside any object, observed or not."""
        return unfold(self.occupancy_head(coarse_BCXYZ))[:, 0].float() - detector.PRIOR_LOGIT

    def proposals(self, scene: SceneFeatures, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """The best ``count`` boxes of the dense detector: centres BN3, sizes BN3, scores BN."""
        output = scene.objectness_BXYZ, scene.deltas_B6XYZ
        return detector.top_peaks(self.cfg.detector, *output, self.voxels, count)

    def regions(self, scene: SceneFeatures, boxes: tuple[Tensor, Tensor]) -> RoiOutput:
        """Output of the second stage for boxes with centres BN3 and sizes BN3."""
        coarse = scene.coarse_BCXYZ, self.coarse_grid
        output: RoiOutput = self.roi(scene.views, scene.features_BVHWC, coarse, boxes)
        return output

    def refined(self, boxes: tuple[Tensor, Tensor], output: RoiOutput) -> tuple[Tensor, Tensor]:
        """Boxes corrected by the second stage: centres BN3, sizes BN3."""
        return detector.apply_deltas(*boxes, output.deltas_BN6, self.cfg.detector.anchor_m)

    def detect(self, scene: SceneFeatures) -> tuple[Tensor, Tensor, Tensor]:
        """Final boxes of one scene (B = 1), best first: centres N3, sizes N3, scores N."""
        assert len(scene.coarse_BCXYZ) == 1, "detect takes one scene"
        cfg = self.cfg.detector
        boxes = self.proposals(scene, cfg.num_peaks)[:2]
        output = self.regions(scene, boxes)
        (centers_N3,), (sizes_N3,) = self.refined(boxes, output)
        scores_N = output.score_BN[0].sigmoid()
        good = (scores_N >= cfg.min_score).nonzero()[:, 0]
        kept = detector.nms_3d(centers_N3[good], sizes_N3[good], scores_N[good], cfg.max_iou)
        kept = good[kept]
        return centers_N3[kept], sizes_N3[kept], scores_N[kept]

    def fields(self, scene: SceneFeatures) -> tuple[Field, Field]:
        """Fields to render: the scene map and the background around it."""
        near = Field(self.scene_map(scene), self.cfg.grid)
        return near, self.background(scene.views, scene.features_BVHWC)

    def render(
        self, scene: SceneFeatures, K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int]
    ) -> Tensor:
        """Predicted RGB BHW3, about [0, 1], from other cameras."""
        rgb: Tensor = self.decoder(*self.fields(scene), K_B33, world_T_cam_B44, size)[0]
        return rgb
