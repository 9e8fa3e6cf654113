"""The camera above the table: where things are in its pictures."""

import numpy as np

from oes.config import params
from oes.episode import Camera, Floats
from oes.geom.camera import intrinsics, project
from oes.geom.se3 import rigid

DOWNWARD = np.array(
    [[1.0, 0, 0], [0, -1, 0], [0, 0, -1]]
)  # camera axes (right, down, forward) in the world


@params
class OverheadView:
    """Square pictures of side ``side_px`` from ``height_m`` above the table's centre; at its height
    they show ``half_m`` to each side.
    """

    side_px: int
    height_m: float
    half_m: float


class Overhead:
    """Looks straight down. Pixel coordinates here run from -1 to 1 over the picture, x to the
    right, y downward.
    """

    def __init__(self, cfg: OverheadView) -> None:
        self.cfg = cfg
        fov_deg = float(np.degrees(2 * np.arctan2(cfg.half_m, cfg.height_m)))
        pose = rigid(DOWNWARD, np.array([0.0, 0.0, cfg.height_m]))
        self.camera = Camera(
            "overhead",
            intrinsics(fov_deg, cfg.side_px, cfg.side_px),
            pose,
            cfg.side_px,
            cfg.side_px,
        )

    def place(self, world: Floats) -> Floats:
        """Where points (..., 3) appear: (..., 2)."""
        pixels, _ = project(self.camera.K_33, self.camera.world_T_cam_44, world)
        return np.asarray(pixels / self.cfg.side_px * 2 - 1)

    def ground(self, place: Floats, height_m: Floats) -> Floats:
        """Where in the world (x, y) something at a height appears at ``place`` (..., 2)."""
        per_unit = self.cfg.half_m * (self.cfg.height_m - height_m) / self.cfg.height_m
        return np.asarray(place * per_unit[..., None] * [1, -1])
