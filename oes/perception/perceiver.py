"""The trained network behind plain calls: images in, boxes, objects and predicted views out. And
its file.
"""

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
from oes.objects import Objects
from oes.perception.lift import SIGNED, UNSEEN, Views, lift, views_of
from oes.perception.network import PerceptionNet, PerceptionNetConfig, SceneFeatures
from oes.perception.rays import Field
from oes.training.precision import half_precision
from oes.training.tensor_io import read_tensors, write_tensors

PERCEPTION_FORMAT = "oes-perception-3"
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
        """Read what ``save`` wrote. Raises CheckpointError: missing, unreadable, foreign, or of
        another network.
        """
        cfg, tensors = _read(path)
        net = PerceptionNet(cfg)
        try:
            net.load_state_dict(tensors)
        except RuntimeError as error:
            raise PerceptionFileError(
                f"{path}: weights do not fit the stored config: {_first_line(error)}"
            ) from error
        return cls(net, device or torch.device("cpu"))

    def save(self, path: Path) -> None:
        """Weights as safetensors, the config as JSON in its metadata."""
        tensors = {name: value.cpu() for name, value in self.net.state_dict().items()}
        write_tensors(tensors, path, {"format": PERCEPTION_FORMAT, "config": to_json(self.net.cfg)})

    @torch.inference_mode()
    def encode(self, frames: Frames, cameras: Sequence[Camera]) -> SceneFeatures:
        """The scene (B = 1) seen by one or more posed views, in any order. Raises ValueError
        without a view.
        """
        return self.encode_views(views_of(frames, list(cameras)))

    @torch.inference_mode()
    def encode_views(self, views: Views) -> SceneFeatures:
        """Several scenes at once, each seen by the same number of views."""
        with half_precision(self.device):
            return self.net.encode(views.to(self.device))

    @torch.inference_mode()
    def detect(self, scene: SceneFeatures) -> tuple[Tensor, Tensor, Tensor]:
        """Boxes of the objects of one scene: centres N3, sizes N3 (metres, world axes), scores N,
        best first.
        """
        with half_precision(self.device):
            return self.net.detect(scene)

    @torch.inference_mode()
    def crops(self, scene: SceneFeatures, centers_BN3: Tensor, sizes_BN3: Tensor) -> Tensor:
        """Object crops BNCXYZ centred at the boxes; all but the first channel end about a voxel
        outside the mask.

        Channels: mask probability; depth behind the surfaces that the views show (0 in front, 1/2
        on them, 1 deep); hidden from every view; then the scene features.
        """
        boxes, window = (
            (centers_BN3.to(self.device), sizes_BN3.to(self.device)),
            self.net.roi.window,
        )
        if centers_BN3.numel() == 0:
            channels = 1 + NUM_SURFACE + self.net.cfg.map_features
            return centers_BN3.new_zeros(*centers_BN3.shape[:2], channels, *window.shape)
        with half_precision(self.device):
            mask_BNXYZ = self.net.regions(scene, boxes).mask_BKXYZ.sigmoid()
            scene_map = self.net.scene_map(scene)
        around = F.max_pool3d(mask_BNXYZ, 3, stride=1, padding=1)[:, :, None]
        features = crop(scene_map, self.net.cfg.grid, boxes[0], window)
        return torch.cat(
            [mask_BNXYZ[:, :, None], self._surfaces(scene, boxes[0]) * around, features * around],
            dim=2,
        )

    @torch.inference_mode()
    def cylinders(
        self,
        scene: SceneFeatures,
        centers_BN3: Tensor,
        sizes_BN3: Tensor,
        mask_BNXYZ: Tensor | None = None,
    ) -> Tensor:
        """Inputs (BN)CKL of the surface head for boxes of B scenes; the masks are those of
        ``crops``, if at hand.
        """
        head, (batch, count) = self.net.surface, centers_BN3.shape[:2]
        boxes = (centers_BN3.to(self.device), sizes_BN3.to(self.device))
        if mask_BNXYZ is None:
            with half_precision(self.device):
                mask_BNXYZ = self.net.regions(scene, boxes).mask_BKXYZ.sigmoid()
        flat = boxes[0].flatten(0, 1), boxes[1].flatten(0, 1)
        places = head.places(*flat).reshape(batch, -1, 3)
        lifted = lift(
            self.net.cfg.lift, scene.views, scene.features_BVHWC, places, between_pixels=True
        ).reshape(batch * count, -1, self.net.lifted)
        cameras = scene.views.world_T_cam_BV44[:, :, :3, 3].repeat_interleave(count, 0)
        return head.inputs(
            lifted, mask_BNXYZ.to(self.device).flatten(0, 1), self.net.roi.window, flat, cameras
        )

    @torch.inference_mode()
    def surfaces(
        self, scene: SceneFeatures, centers_N3: Tensor, sizes_N3: Tensor, mask_NXYZ: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Completed surfaces of objects of one scene: outlines NRK3 and centres of mass N3, as in
        ``Objects``.
        """
        cylinder = self.net.cfg.surface.cylinder
        if not len(centers_N3):
            return centers_N3.new_zeros(
                0, cylinder.rows, cylinder.directions, 3
            ), centers_N3.new_zeros(0, 3)
        inputs_NCKL = self.cylinders(scene, centers_N3[None], sizes_N3[None], mask_NXYZ[None])
        with half_precision(self.device):
            found = self.net.surface(inputs_NCKL)
        return found.outline(), found.mass_P3

    def _surfaces(self, scene: SceneFeatures, centers_BN3: Tensor) -> Tensor:
        """The two geometric channels of ``crops``, BN2XYZ, straight from the depth images."""
        window = self.net.roi.window
        points = centers_BN3[:, :, None] + centers(window, self.device).reshape(-1, 3)
        lifted = lift(
            self.net.cfg.lift, scene.views, scene.features_BVHWC[..., :1], points.flatten(1, 2)
        ).float()
        surfaces = torch.stack([(1 - lifted[..., SIGNED]) / 2, lifted[..., UNSEEN]], dim=-1)
        return surfaces.reshape(*centers_BN3.shape[:2], *window.shape, NUM_SURFACE).movedim(-1, 2)

    @torch.inference_mode()
    def objects(
        self,
        scene: SceneFeatures,
        centers_N3: Tensor,
        sizes_N3: Tensor,
        scores_N: Tensor,
        frames: Frames,
        cameras: Sequence[Camera],
    ) -> Objects:
        """Objects (unbatched, on the CPU) of one scene at the given boxes, true or detected; N may
        be 0.
        """
        boxes = (centers_N3.float().cpu(), sizes_N3.float().cpu())
        crops = self.crops(scene, boxes[0][None], boxes[1][None])[0]
        radial_profile_NRD3, mass_N3 = self.surfaces(scene, *boxes, crops[:, 0])
        surface = (radial_profile_NRD3.float().cpu(), mass_N3.float().cpu())
        return objects_of(
            boxes, scores_N.float().cpu(), crops.float().cpu(), surface, frames, cameras
        )

    @torch.inference_mode()
    def fields(self, scene: SceneFeatures) -> tuple[Field, Field]:
        """What can be rendered of one scene: its map, and what surrounds it."""
        with half_precision(self.device):
            near = Field(self.net.scene_map(scene), self.net.cfg.grid)
            return near, self.net.backdrop(scene.views, scene.features_BVHWC)

    @torch.inference_mode()
    def look(self, near: Field, backdrop: Field, cameras: Sequence[Camera]) -> Frames:
        """The images (RGB and depth, nothing segmented) that cameras of one size would see of one
        scene's fields.
        """
        K_V33 = (
            torch.from_numpy(np.stack([camera.K_33 for camera in cameras])).float().to(self.device)
        )
        poses_V44 = (
            torch.from_numpy(np.stack([camera.world_T_cam_44 for camera in cameras]))
            .float()
            .to(self.device)
        )
        nears, backdrops = near.repeated(len(cameras)), backdrop.repeated(len(cameras))
        size = (cameras[0].height_px, cameras[0].width_px)
        with half_precision(self.device):
            rgb, depth = self.net.decoder.rgbd(nears, backdrops, K_V33, poses_V44, size)
        rgb_VHW3 = (rgb.clamp(0, 1) * 255).round().to(torch.uint8).cpu().numpy()
        return Frames(
            rgb_VHW3, depth.float().cpu().numpy(), np.zeros(rgb_VHW3.shape[:3], dtype=np.uint8)
        )

    def render(self, scene: SceneFeatures, camera: Camera) -> NDArray[np.uint8]:
        """The image HW3 that the camera would see of one scene."""
        image: NDArray[np.uint8] = self.look(*self.fields(scene), [camera]).rgb_VHW3[0]
        return image


def objects_of(
    boxes: tuple[Tensor, Tensor],
    scores_N: Tensor,
    crop_NCXYZ: Tensor,
    surface: tuple[Tensor, Tensor],
    frames: Frames,
    cameras: Sequence[Camera],
) -> Objects:
    """Put together what is known of N objects: ``boxes`` (centres N3, sizes N3), ``surface``
    (outlines, masses).
    """
    count = len(boxes[0])
    rows = torch.from_numpy(
        np.stack([camera.world_T_cam_44[:3].reshape(12) for camera in cameras])
    ).float()
    return Objects(
        center_N3=boxes[0],
        size_N3=boxes[1],
        score_N=scores_N,
        valid_N=torch.ones(count, dtype=torch.bool),
        crop_NCXYZ=crop_NCXYZ,
        image_NV3HW=image_crops(boxes, frames, cameras),
        camera_NV12=rows.expand(count, -1, -1).clone(),
        view_NV=torch.ones(count, len(cameras), dtype=torch.bool),
        radial_profile_NRD3=surface[0],
        com_offset_N3=surface[1],
    )


def image_crops(boxes: tuple[Tensor, Tensor], frames: Frames, cameras: Sequence[Camera]) -> Tensor:
    """uint8 NV3HW: the square around each projected box, in every view; black outside the image."""
    signs = torch.cartesian_prod(*[torch.tensor([-0.5, 0.5])] * 3)
    corners = boxes[0][:, None] + boxes[1][:, None] * signs
    per_view = [
        _image_crop(corners, rgb, camera)
        for rgb, camera in zip(frames.rgb_VHW3, cameras, strict=True)
    ]
    return torch.stack(per_view, dim=1)


def _image_crop(corners_N83: Tensor, rgb_HW3: NDArray[np.uint8], camera: Camera) -> Tensor:
    """uint8 N3HW from one view."""
    count = len(corners_N83)
    flat = corners_N83.reshape(-1, 3).double().numpy()
    uv = (
        torch.from_numpy(project(camera.K_33, camera.world_T_cam_44, flat)[0])
        .float()
        .reshape(count, 8, 2)
    )
    low, high = uv.amin(1), uv.amax(1)
    half = (high - low).amax(-1) / 2 * IMAGE_MARGIN
    steps = (torch.arange(IMAGE_PX) + 0.5) / IMAGE_PX * 2 - 1
    v, u = torch.meshgrid(steps, steps, indexing="ij")
    pix = ((low + high) / 2)[:, None, None] + half[:, None, None, None] * torch.stack(
        [u, v], dim=-1
    )
    unit = pix / torch.tensor([camera.width_px, camera.height_px]) * 2 - 1
    image = torch.from_numpy(np.ascontiguousarray(rgb_HW3)).movedim(-1, 0).float()
    crops = F.grid_sample(
        image.expand(count, -1, -1, -1), unit, padding_mode="zeros", align_corners=False
    )
    return crops.round().to(torch.uint8)


def _read(path: Path) -> tuple[PerceptionNetConfig, dict[str, Tensor]]:
    """Config and weights of a file of ours."""
    tensors, about = read_tensors(path, PERCEPTION_FORMAT, PerceptionFileError)
    try:
        return from_json(about.get("config", ""), PerceptionNetConfig, str(path)), tensors
    except ParamsError as error:
        raise PerceptionFileError(
            f"{path}: stored config is not of this version: {error}"
        ) from error


def _first_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
