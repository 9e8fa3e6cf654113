"""The camera rig: 27 nominal views around the table, perturbed afresh at every recorded state
(paper appendix B).
"""

import numpy as np

from oes.config import params
from oes.episode import Camera, Floats
from oes.geom.camera import intrinsics, look_at


@params
class RigConfig:
    """Azimuths run evenly over ``azimuth_deg`` (0 = opposite the robot, at +x); jitter is uniform,
    +- the value.
    """

    azimuth_deg: tuple[float, float]
    num_azimuths: int
    elevation_deg: tuple[float, ...]
    target_m: tuple[float, float, float]
    distance_m: float
    fov_deg: float
    width_px: int
    height_px: int
    jitter_deg: float
    jitter_m: float


def rig(cfg: RigConfig, rng: np.random.Generator) -> tuple[Camera, ...]:
    """Cameras cam_00.. (index = elevation_i * num_azimuths + azimuth_i), each perturbed.

    Azimuth and elevation move by up to ``jitter_deg``, the distance and every coordinate of the
    point looked at by up to ``jitter_m``.
    """
    azimuths = np.linspace(*cfg.azimuth_deg, cfg.num_azimuths)
    nominal = [(elevation, azimuth) for elevation in cfg.elevation_deg for azimuth in azimuths]
    K_33 = intrinsics(cfg.fov_deg, cfg.width_px, cfg.height_px)
    return tuple(
        Camera(
            f"cam_{i:02d}", K_33, _pose(cfg, elevation, azimuth, rng), cfg.width_px, cfg.height_px
        )
        for i, (elevation, azimuth) in enumerate(nominal)
    )


def _pose(
    cfg: RigConfig, elevation_deg: float, azimuth_deg: float, rng: np.random.Generator
) -> Floats:
    """world_T_cam of one perturbed camera."""
    elevation, azimuth = np.radians(
        np.array([elevation_deg, azimuth_deg]) + rng.uniform(-1, 1, 2) * cfg.jitter_deg
    )
    distance = cfg.distance_m + rng.uniform(-1, 1) * cfg.jitter_m
    target = np.array(cfg.target_m) + rng.uniform(-1, 1, 3) * cfg.jitter_m
    return look_at(target + distance * direction(elevation, azimuth), target)


def direction(elevation_rad: float, azimuth_rad: float) -> Floats:
    """Unit vector towards a point of the sphere on which the cameras stand."""
    level = np.cos(elevation_rad)
    return np.array(
        [level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad)]
    )
