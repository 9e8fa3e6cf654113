"""The perception network: views -> lifted volume -> 3D U-Net -> scene maps, and the heads that read
them.
"""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.voxels import Grid, centers, fold_order, unfold
from oes.perception.blocks import UNet
from oes.perception.decoder import BackgroundField, DecoderConfig, FieldHead, ViewDecoder
from oes.perception.detector import (
    RARE_LOGIT,
    DetectorConfig,
    DetectorHead,
    apply_deltas,
    nms_3d,
    top_peaks,
)
from oes.perception.lift import NUM_GEOMETRY, LiftConfig, Views, lift
from oes.perception.rays import Field
from oes.perception.roi import RoiConfig, RoiHead, RoiOutput
from oes.perception.surface import SurfaceHead, SurfaceHeadConfig


@params
class PerceptionNetConfig:
    """Sizes of the network. ``grid`` is that of the scene map; the U-Net works on 2x2x2 blocks of
    it.

    ``image_features``: channels of the 2D net beside RGB; ``map_features``: channels of the scene
    map.
    """

    grid: Grid
    lift: LiftConfig
    image_features: int
    channels: tuple[int, ...]
    blocks: tuple[int, ...]
    map_features: int
    detector: DetectorConfig
    roi: RoiConfig
    decoder: DecoderConfig
    surface: SurfaceHeadConfig


@dataclass(frozen=True)
class SceneFeatures:
    """What the encoder knows of B scenes, on blocks of 2x2x2 voxels: ``PerceptionNet.scene_map``
    gives the fine map.

    ``features_BVHWC``: the 2D net's, kept for lifting regions; ``lifted_BCXYZ``: the U-Net's input,
    ``coarse_BCXYZ`` its output; then what the dense detector makes of that.
    """

    views: Views
    features_BVHWC: Tensor
    lifted_BCXYZ: Tensor
    coarse_BCXYZ: Tensor
    objectness_BXYZ: Tensor
    deltas_B6XYZ: Tensor

    def first(self, count: int) -> "SceneFeatures":
        """The first ``count`` scenes."""
        tensors = {name: value[:count] for name, value in vars(self).items() if name != "views"}
        return SceneFeatures(views=self.views.first(count), **tensors)


class ImageEncoder(nn.Module):
    """Two 3x3 convolutions over RGB and depth; RGB itself stays the first three features."""

    def __init__(self, features: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(4, 2 * features, 3, padding=1)
        self.second = nn.Conv2d(2 * features, features, 3, padding=1)

    def forward(self, views: Views) -> Tensor:
        """Features BVHW(3+C) of every pixel."""
        batch, num_views = views.depth_m_BVHW.shape[:2]
        image = (
            torch.cat([views.rgb_BVHW3, views.depth_m_BVHW[..., None]], dim=-1)
            .flatten(0, 1)
            .movedim(-1, 1)
        )
        x = self.second(F.relu(self.first(image))).movedim(1, -1)
        return torch.cat([views.rgb_BVHW3.to(x.dtype), x.unflatten(0, (batch, num_views))], dim=-1)


class PerceptionNet(nn.Module):
    """All trained parts. ``encode`` once per scene; the other methods read the scene."""

    points: Tensor
    voxels: Tensor

    def __init__(self, cfg: PerceptionNetConfig) -> None:
        super().__init__()
        self.cfg, self.coarse_grid = cfg, cfg.grid.halved()
        lifted = self.lifted = NUM_GEOMETRY + 3 + cfg.image_features
        self.register_buffer("points", fold_order(centers(cfg.grid)), persistent=False)
        self.register_buffer("voxels", centers(self.coarse_grid), persistent=False)
        self.image = ImageEncoder(cfg.image_features)
        self.unet = UNet(8 * lifted + 1, cfg.channels, cfg.blocks)
        self.map = FieldHead(cfg.channels[0], lifted, 1, cfg.map_features, self.coarse_grid.shape)
        self.solid = nn.Conv3d(cfg.channels[0], 8, 1)
        self.detector = DetectorHead(cfg.channels[0], cfg.detector)
        self.roi = RoiHead(cfg.roi, cfg.lift, lifted, cfg.channels[0])
        self.backdrop = BackgroundField(cfg.decoder.backdrop, lifted, cfg.map_features)
        self.decoder = ViewDecoder(cfg.decoder, cfg.map_features)
        self.surface = SurfaceHead(cfg.surface, lifted)

    def encode(self, views: Views) -> SceneFeatures:
        """The scenes seen by ``views`` (one or more each, all scenes the same number, in any
        order).
        """
        batch = len(views.depth_m_BVHW)
        features = self.image(views)
        points = self.points.reshape(1, -1, 3).expand(batch, -1, -1)
        lifted = lift(self.cfg.lift, views, features, points)
        height = (
            self.voxels[None, ..., 2:].expand(batch, -1, -1, -1, -1) / self.cfg.detector.anchor_m
        )
        folded = torch.cat(
            [lifted.reshape(batch, *self.coarse_grid.shape, -1), height.to(lifted.dtype)], dim=-1
        )
        inputs = folded.movedim(-1, 1)
        coarse = self.unet(inputs)
        return SceneFeatures(views, features, inputs, coarse, *self.detector(coarse))

    def scene_map(self, scene: SceneFeatures) -> Tensor:
        """The 3D feature map BCXYZ on ``cfg.grid``; channel 0 is a density."""
        field: Tensor = self.map(scene.coarse_BCXYZ, scene.lifted_BCXYZ)
        return field

    def occupancy(self, coarse_BCXYZ: Tensor) -> Tensor:
        """Logits BXYZ on ``cfg.grid`` that a voxel belongs to any object, seen or not; table and
        robot are none.
        """
        return unfold(self.solid(coarse_BCXYZ))[:, 0].float() - RARE_LOGIT

    def proposals(self, scene: SceneFeatures, count: int) -> tuple[Tensor, Tensor, Tensor]:
        """The dense detector's best ``count`` boxes of each scene: centres BK3, sizes BK3, scores
        BK.
        """
        return top_peaks(
            self.cfg.detector, scene.objectness_BXYZ, scene.deltas_B6XYZ, self.voxels, count
        )

    def regions(self, scene: SceneFeatures, boxes: tuple[Tensor, Tensor]) -> RoiOutput:
        """Mask, box correction and score of regions given by centres BK3 and sizes BK3."""
        output: RoiOutput = self.roi(
            scene.views, scene.features_BVHWC, scene.coarse_BCXYZ, self.coarse_grid, boxes
        )
        return output

    def refined(self, boxes: tuple[Tensor, Tensor], output: RoiOutput) -> tuple[Tensor, Tensor]:
        """Regions corrected by the deltas the second stage gave them: centres BK3, sizes BK3."""
        return apply_deltas(boxes[0], boxes[1], output.deltas_BK6, self.cfg.detector.anchor_m)

    def detect(self, scene: SceneFeatures) -> tuple[Tensor, Tensor, Tensor]:
        """Final boxes of ONE scene (B = 1): centres N3, sizes N3, scores N, best first; N may be
        0.
        """
        assert len(scene.coarse_BCXYZ) == 1, "detect takes one scene"
        cfg = self.cfg.detector
        centers_BK3, sizes_BK3, _ = self.proposals(scene, cfg.num_peaks)
        output = self.regions(scene, (centers_BK3, sizes_BK3))
        (centers_N3,), (sizes_N3,) = self.refined((centers_BK3, sizes_BK3), output)
        scores = output.score_BK[0].sigmoid()
        good = (scores >= cfg.min_score).nonzero()[:, 0]
        kept = good[nms_3d(centers_N3[good], sizes_N3[good], scores[good], cfg.max_iou)]
        return centers_N3[kept], sizes_N3[kept], scores[kept]

    def render(
        self, scene: SceneFeatures, K_B33: Tensor, world_T_cam_B44: Tensor, size: tuple[int, int]
    ) -> Tensor:
        """Predicted RGB BHW3 in [0, 1] from other cameras."""
        near, backdrop = (
            Field(self.scene_map(scene), self.cfg.grid),
            self.backdrop(scene.views, scene.features_BVHWC),
        )
        image: Tensor = self.decoder(near, backdrop, K_B33, world_T_cam_B44, size)
        return image
