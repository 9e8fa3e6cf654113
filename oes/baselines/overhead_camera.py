"""Geometry of the fixed camera above the table.

Normalised image coordinates (``ndc``) run from -1 to 1 over the square image, x right, y down.
"""

import numpy as np

from oes.config import params
from oes.episode import Camera, Floats
from oes.geom.camera import intrinsics, project
from oes.geom.se3 import rigid

# Columns are the camera axes (right, down, forward) in the world.
DOWNWARD = np.diag([1.0, -1.0, -1.0])


@params
class OverheadView:
    """Square images of side ``side_px`` from ``height_m`` above the table's centre.

    At table height they cover ``half_m`` to each side.
    """

    side_px: int
    height_m: float
    half_m: float


class OverheadCamera:
    """The camera of an ``OverheadView``, with world z up and the image plane horizontal."""

    def __init__(self, cfg: OverheadView) -> None:
        self.cfg = cfg
        # The field of view is set at table height, where the objects are.
        fov_deg = float(np.degrees(2 * np.arctan2(cfg.half_m, cfg.height_m)))
        pose = rigid(DOWNWARD, np.array([0.0, 0.0, cfg.height_m]))
        side = cfg.side_px
        self.camera = Camera("overhead", intrinsics(fov_deg, side, side), pose, side, side)

    def project(self, world: Floats) -> Floats:
        """Normalised image coordinates (..., 2) of world points (..., 3)."""
        pixels, _ = project(self.camera.K_33, self.camera.world_T_cam_44, world)
        return np.asarray(pixels / self.cfg.side_px * 2 - 1)

    def unproject(self, ndc: Floats, height_m: Floats) -> Floats:
        """World x and y (..., 2) of points at known heights (...)."""
        scale = self.cfg.half_m * (self.cfg.height_m - height_m) / self.cfg.height_m
        return np.asarray(ndc * scale[..., None] * [1, -1])
