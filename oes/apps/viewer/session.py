"""State of the viewer: one perceived episode, the user's changes of it, and the forecast."""

from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray

from oes.counterfactual.compose import compose, visible_features
from oes.counterfactual.edits import Scenario, move_object, redirect_push, shift_rod
from oes.counterfactual.forecast import (
    ObjectMotion,
    forecast_motions,
    perceive_first_state,
    true_motions,
)
from oes.dynamics.unroll import DynamicsModel
from oes.episode import Camera, Episode, Floats, Frames, Pixels
from oes.geom.camera import project, unproject
from oes.geom.voxels import centers
from oes.meshes.catalogue import Catalogue
from oes.perception.perceiver import Perceiver
from oes.perception.rays import Field
from oes.record.dataset import FrameSource
from oes.sim.simulate import replay_bodies
from oes.sim.world import SimConfig

PointsRGB = tuple[NDArray[np.float32], NDArray[np.uint8]]  # positions P3 (m), colours P3
VIEWER_MODEL = "oes"
MIN_OCCUPANCY = 0.5  # of the voxels that are shown, as mask or as opacity


@dataclass
class Change:
    """The user's changes: shifts of objects N3 and of the push's start 3 (m), turn of the push."""

    shift_N3: Floats
    start_3: Floats = field(default_factory=lambda: np.zeros(3))
    turn_rad: float = 0.0


class Session:
    """An episode perceived from one camera; ``change`` may be altered at any time."""

    def __init__(
        self, perceiver: Perceiver, model: DynamicsModel, source: FrameSource, camera_i: int
    ) -> None:
        """``source`` holds one episode."""
        self.perceiver, self.model, self.source, self.camera_i = perceiver, model, source, camera_i
        self.first, self.scene = perceive_first_state(perceiver, source, 0, camera_i)
        self.change = self.unchanged()

    def unchanged(self) -> Change:
        """A change of nothing."""
        return Change(np.zeros((len(self.first.scene.truth), 3)))

    @property
    def case(self) -> Scenario:
        """The scenario with the current change."""
        case = shift_rod(redirect_push(self.first, self.change.turn_rad), self.change.start_3)
        for i, shift_3 in enumerate(self.change.shift_N3):
            case = move_object(case, i, shift_3)
        return case

    def forecast(self) -> tuple[Scenario, ObjectMotion]:
        """The model's forecast of the changed scenario."""
        case = self.case
        return case, forecast_motions(case, {VIEWER_MODEL: self.model})[VIEWER_MODEL]

    def simulated(self, catalogue: Catalogue, sim: SimConfig) -> Episode:
        """Bullet's simulation of the changed scenario."""
        episode = self.case.episode
        return replay_bodies(catalogue, sim, episode, episode.bodies)

    def render(self, case: Scenario, motion: ObjectMotion, T: int, camera: Camera) -> Pixels:
        """The forecast at T, rendered for a camera."""
        near = compose(self.scene, motion.poses(case.poses, T))
        frames = self.perceiver.render_fields(near, self.scene.far_field, [camera])
        image: Pixels = frames.rgb_VHW3[0]
        return image

    def error_mm(self, case: Scenario, motion: ObjectMotion, happened: Episode, T: int) -> float:
        """Mean translation error at T over the objects matched to true ones; NaN without any."""
        known = [i for i, true_i in enumerate(case.scene.truth) if true_i >= 0]
        if T == 0 or not known:
            return 0.0 if known else float("nan")
        apart = motion.translation_TN3[T - 1] - true_motions(case, happened).translation_TN3[T - 1]
        return float(apart[known].norm(dim=-1).mean() * 1e3)

    def object_points(self, i: int) -> PointsRGB:
        """The voxels of a perceived object about its centre, coloured from the input image."""
        mask = self.first.scene.objects.crop_NCXYZ[i, 0]
        points_P3 = centers(self.scene.window)[mask > MIN_OCCUPANCY]
        frames, camera = self.recorded(0, self.camera_i)
        places_P3 = (points_P3 + self.scene.center_N3[i]).double().numpy()
        pix_P2, _ = project(camera.K_33, camera.world_T_cam_44, places_P3)
        last = [[camera.width_px - 1], [camera.height_px - 1]]
        column_P, row_P = np.clip(pix_P2.T, 0, last).astype(int)
        return points_P3.numpy().astype(np.float32), frames.rgb_VHW3[0][row_P, column_P]

    def map_points(self) -> PointsRGB:
        """The opaque voxels of the feature map; colours are its three principal components."""
        field = Field(self.scene.map_CXYZ[None], self.scene.grid)
        shown = visible_features(field)[0] > MIN_OCCUPANCY
        features_P7 = self.scene.map_CXYZ[1:, shown].T
        centred = features_P7 - features_P7.mean(0)
        torch.manual_seed(0)
        main_P3 = centred @ torch.pca_lowrank(centred, q=3)[2]
        rgb_P3 = (0.5 + main_P3 / (4 * main_P3.std(0).clamp(min=1e-6))).clamp(0, 1)
        points_P3 = centers(self.scene.grid)[shown]
        return points_P3.numpy().astype(np.float32), (rgb_P3 * 255).byte().numpy()

    def recorded(self, T: int, camera_i: int) -> tuple[Frames, Camera]:
        """The recorded image of a camera at T."""
        frames, (camera,) = self.source.read(0, T, [camera_i])
        return frames, camera

    def input_points(self) -> PointsRGB:
        """The point cloud of the input image."""
        frames, camera = self.recorded(0, self.camera_i)
        depth = torch.from_numpy(frames.depth_m_VHW[0])
        K_33, pose_44 = (torch.from_numpy(x).float() for x in (camera.K_33, camera.world_T_cam_44))
        hit = depth > 0
        return unproject(K_33, pose_44, depth)[hit].numpy(), frames.rgb_VHW3[0][hit.numpy()]
