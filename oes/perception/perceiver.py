"""The trained perception network: images in; boxes, objects and predicted views out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from oes.config import ParamsError, from_json, to_json
from oes.episode import Camera, Frames
from oes.geom.camera import project
from oes.geom.voxels import centers, crop
from oes.objects import Objects, map_tensors
from oes.perception.lift import SIGNED_DISTANCE, UNOBSERVED, Views, camera_matrices, lift, views_of
from oes.perception.network import PerceptionNet, PerceptionNetConfig, SceneFeatures
from oes.perception.rays import Field
from oes.training.precision import half_precision
from oes.training.tensor_io import read_tensors, write_tensors

PERCEPTION_FORMAT = "oes-perception-4"
IMAGE_PX = 32
NUM_SURFACE = 2
IMAGE_MARGIN = 1.15


class PerceptionFileError(ValueError):
    """A weights file that cannot be used; names the file and the reason."""


class Perceiver:
    """One network on one device, without gradients."""

    def __init__(self, net: PerceptionNet, device: torch.device) -> None:
        self.net, self.device = net.to(device).eval(), device

    @classmethod
    def load(cls, path: Path, device: torch.device | None = None) -> "Perceiver":
        """Read a file of ``save``. Raises PerceptionFileError."""
        tensors, metadata = read_tensors(path, PERCEPTION_FORMAT, PerceptionFileError)
        config = metadata.get("config", "")
        try:
            net = PerceptionNet(from_json(config, PerceptionNetConfig, str(path)))
            net.load_state_dict(tensors)
        except ParamsError as error:
            reason = f"stored config is not of this version: {error}"
            raise PerceptionFileError(f"{path}: {reason}") from error
        except RuntimeError as error:
            reason = "weights do not fit the stored config: " + " ".join(str(error).split())[:200]
            raise PerceptionFileError(f"{path}: {reason}") from error
        return cls(net, device or torch.device("cpu"))

    def save(self, path: Path) -> None:
        """Weights as safetensors, the config as JSON in its metadata."""
        tensors = {name: value.cpu() for name, value in self.net.state_dict().items()}
        write_tensors(tensors, path, {"format": PERCEPTION_FORMAT, "config": to_json(self.net.cfg)})

    @torch.inference_mode()
    def encode(self, frames: Frames, cameras: Sequence[Camera]) -> SceneFeatures:
        """Features of one scene (B = 1) from one or more posed views, in any order.

        Raises ValueError without a view.
        """
        return self.encode_views(views_of(frames, cameras))

    @torch.inference_mode()
    def encode_views(self, views: Views) -> SceneFeatures:
        """Features of several scenes with the same number of views."""
        with half_precision(self.device):
            return self.net.encode(map_tensors(views, lambda x: x.to(self.device)))

    @torch.inference_mode()
    def detect(self, scene: SceneFeatures) -> tuple[Tensor, Tensor, Tensor]:
        """Boxes of one scene: centres N3, sizes N3 (metres, world axes), scores N, best first."""
        with half_precision(self.device):
            return self.net.detect(scene)

    @torch.inference_mode()
    def masks(self, scene: SceneFeatures, boxes: tuple[Tensor, Tensor]) -> Tensor:
        """Mask probabilities NXYZ of one scene's boxes, in ``net.roi.window`` around each centre.

        ``boxes``, here and below: centres N3 and sizes N3.
        """
        center_N3, size_N3 = (value.to(self.device) for value in boxes)
        with half_precision(self.device):
            regions = self.net.regions(scene, (center_N3[None], size_N3[None]))
            mask_NXYZ: Tensor = regions.mask_BNXYZ[0].sigmoid()
        return mask_NXYZ

    @torch.inference_mode()
    def crops(self, scene: SceneFeatures, boxes: tuple[Tensor, Tensor]) -> Tensor:
        """Object crops NCXYZ of one scene; N may be 0.

        Channels: the mask; position relative to the surfaces in the depth images (0 in front, 1/2
        on them, 1 behind); whether all views are occluded; the scene features. All but the first
        are 0 further than a voxel from the mask.
        """
        window, center_1N3 = self.net.roi.window, boxes[0][None].to(self.device)
        if not len(boxes[0]):
            return boxes[0].new_zeros(0, 1 + NUM_SURFACE + self.net.cfg.map_features, *window.shape)
        mask_N1XYZ = self.masks(scene, boxes)[:, None]
        with half_precision(self.device):
            scene_map = self.net.scene_map(scene)
        points_1NQ3 = center_1N3[:, :, None] + centers(window, self.device).reshape(-1, 3)
        # A single feature: only the geometry is used.
        inputs = scene.views, scene.features_BVHWC[..., :1], points_1NQ3.flatten(1, 2)
        lifted_1QC = lift(self.net.cfg.lift, *inputs).float()
        behind_1Q = (1 - lifted_1QC[..., SIGNED_DISTANCE]) / 2
        depth_1Q2 = torch.stack([behind_1Q, lifted_1QC[..., UNOBSERVED]], -1)
        depth_N2XYZ = depth_1Q2.reshape(-1, *window.shape, NUM_SURFACE).movedim(-1, 1)
        features_NCXYZ = crop(scene_map, self.net.cfg.grid, center_1N3, window)[0]
        # Surfaces lie on the border of the mask, half of their voxels outside.
        dilated_N1XYZ = F.max_pool3d(mask_N1XYZ, 3, stride=1, padding=1)
        masked = (x * dilated_N1XYZ for x in (depth_N2XYZ, features_NCXYZ))
        return torch.cat([mask_N1XYZ, *masked], dim=1)

    @torch.inference_mode()
    def surface_inputs(
        self, scene: SceneFeatures, boxes: tuple[Tensor, Tensor], mask_NXYZ: Tensor
    ) -> Tensor:
        """Inputs NCDX of the surface head for one scene's boxes and their ``masks``."""
        head, net, views = self.net.surface, self.net, scene.views
        center_N3, size_N3, mask_NXYZ = (x.to(self.device) for x in (*boxes, mask_NXYZ))
        points_NQ3 = head.world_points(center_N3, size_N3)
        inputs = views, scene.features_BVHWC, points_NQ3.reshape(1, -1, 3)
        lifted_1QC = lift(net.cfg.lift, *inputs, interpolate_depth=True)
        lifted_NQC = lifted_1QC.reshape(*points_NQ3.shape[:2], -1)
        camera_NV3 = views.world_T_cam_BV44[:, :, :3, 3].expand(len(center_N3), -1, -1)
        return head.inputs(lifted_NQC, mask_NXYZ, net.roi.window, (center_N3, size_N3), camera_NV3)

    @torch.inference_mode()
    def surfaces(
        self, scene: SceneFeatures, boxes: tuple[Tensor, Tensor], mask_NXYZ: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Radial profiles NRD3 and centres of mass N3 of one scene, as in ``Objects``."""
        cylinder = self.net.cfg.surface.cylinder
        if not len(mask_NXYZ):
            shape = (0, cylinder.num_rows, cylinder.num_directions, 3)
            return mask_NXYZ.new_zeros(shape), mask_NXYZ.new_zeros(0, 3)
        inputs_NCDX = self.surface_inputs(scene, boxes, mask_NXYZ)
        with half_precision(self.device):
            output = self.net.surface(inputs_NCDX)
        return output.radial_profile(), output.com_offset_P3

    @torch.inference_mode()
    def objects(
        self,
        scene: SceneFeatures,
        scored_boxes: tuple[Tensor, Tensor, Tensor],
        frames: Frames,
        cameras: Sequence[Camera],
    ) -> Objects:
        """Objects (unbatched, on the CPU) of one scene at given boxes, as of ``detect``.

        ``frames`` and ``cameras``: the views of the scene. N may be 0.
        """
        center_N3, size_N3, score_N = (x.float().cpu() for x in scored_boxes)
        boxes, count = (center_N3, size_N3), len(center_N3)
        crop_NCXYZ = self.crops(scene, boxes)
        profile_NRD3, com_offset_N3 = self.surfaces(scene, boxes, crop_NCXYZ[:, 0])
        camera_V12 = camera_matrices(cameras)[1][:, :3].flatten(1)
        return Objects(
            center_N3=center_N3,
            size_N3=size_N3,
            score_N=score_N,
            valid_N=torch.ones(count, dtype=torch.bool),
            crop_NCXYZ=crop_NCXYZ.float().cpu(),
            image_NV3HW=image_crops(boxes, frames, cameras),
            camera_NV12=camera_V12.expand(count, -1, -1).clone(),
            view_NV=torch.ones(count, len(cameras), dtype=torch.bool),
            radial_profile_NRD3=profile_NRD3.float().cpu(),
            com_offset_N3=com_offset_N3.float().cpu(),
        )

    @torch.inference_mode()
    def fields(self, scene: SceneFeatures) -> tuple[Field, Field]:
        """Volumes to render one scene from: its map, and the background around it."""
        with half_precision(self.device):
            return self.net.fields(scene)

    @torch.inference_mode()
    def render_fields(self, near: Field, far: Field, cameras: Sequence[Camera]) -> Frames:
        """Predicted RGB and depth (segmentation 0) of ``fields`` from cameras of one size."""
        matrices = (x.to(self.device) for x in camera_matrices(cameras))
        fields = near.repeated(len(cameras)), far.repeated(len(cameras))
        size = (cameras[0].height_px, cameras[0].width_px)
        with half_precision(self.device):
            rgb, depth = self.net.decoder(*fields, *matrices, size)
        rgb_VHW3 = (rgb.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
        seg_VHW = np.zeros(rgb_VHW3.shape[:3], dtype=np.uint8)
        return Frames(rgb_VHW3, depth.float().cpu().numpy(), seg_VHW)

    def render(self, scene: SceneFeatures, camera: Camera) -> NDArray[np.uint8]:
        """Predicted image HW3 of one scene."""
        image: NDArray[np.uint8] = self.render_fields(*self.fields(scene), [camera]).rgb_VHW3[0]
        return image


def image_crops(boxes: tuple[Tensor, Tensor], frames: Frames, cameras: Sequence[Camera]) -> Tensor:
    """uint8 NV3HW: square around each projected box in every view; black outside the image."""
    signs = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5])] * 3)
    corners_N83 = boxes[0][:, None] + boxes[1][:, None] * signs
    points_Q3 = corners_N83.reshape(-1, 3).double().numpy()
    steps = (torch.arange(IMAGE_PX) + 0.5) / IMAGE_PX * 2 - 1
    v, u = torch.meshgrid(steps, steps, indexing="ij")
    crops = []
    for rgb_HW3, camera in zip(frames.rgb_VHW3, cameras, strict=True):
        pix_Q2, _ = project(camera.K_33, camera.world_T_cam_44, points_Q3)
        pix_N82 = torch.from_numpy(pix_Q2).float().reshape(-1, 8, 2)
        low_N2, high_N2 = pix_N82.amin(1), pix_N82.amax(1)
        half_N = (high_N2 - low_N2).amax(-1) / 2 * IMAGE_MARGIN
        offset_NHW2 = half_N[:, None, None, None] * torch.stack([u, v], dim=-1)
        pix_NHW2 = ((low_N2 + high_N2) / 2)[:, None, None] + offset_NHW2
        # grid_sample counts from -1 to 1 between the outer edges of the image.
        unit_NHW2 = pix_NHW2 / torch.tensor([camera.width_px, camera.height_px]) * 2 - 1
        image_3HW = torch.from_numpy(np.ascontiguousarray(rgb_HW3)).movedim(-1, 0).float()
        image_N3HW = image_3HW.expand(len(corners_N83), -1, -1, -1)
        # Pixels outside the image are 0.
        crops.append(F.grid_sample(image_N3HW, unit_NHW2, align_corners=False))
    return torch.stack(crops, dim=1).round().to(torch.uint8)
