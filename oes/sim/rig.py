"""The camera rig: nominal views around the table, perturbed at every state (paper appendix B)."""

import numpy as np

from oes.config import params
from oes.episode import Camera, Floats
from oes.geom.camera import intrinsics, look_at


@params
class RigConfig:
    """Views from a sphere about ``target_m``.

    ``azimuth_deg``: first and last of ``num_azimuths`` evenly spaced ones; 0 is +x, opposite the
    robot.
    ``jitter_deg``, ``jitter_m``: half ranges of the uniform perturbations.
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
    """Perturbed cameras cam_00, ... with index elevation_i * num_azimuths + azimuth_i.

    ``jitter_deg`` applies to azimuth and elevation, ``jitter_m`` to the distance and to every
    coordinate of the target.
    """
    azimuths = np.linspace(*cfg.azimuth_deg, cfg.num_azimuths)
    angles = [(elevation, azimuth) for elevation in cfg.elevation_deg for azimuth in azimuths]
    K_33, size_px = (
        intrinsics(cfg.fov_deg, cfg.width_px, cfg.height_px),
        (cfg.width_px, cfg.height_px),
    )
    return tuple(
        Camera(f"cam_{i:02d}", K_33, _perturbed(cfg, np.array(pair), rng), *size_px)
        for i, pair in enumerate(angles)
    )


def _perturbed(cfg: RigConfig, angles_deg_2: Floats, rng: np.random.Generator) -> Floats:
    """Random ``world_T_cam`` near the view from (elevation, azimuth)."""
    elevation, azimuth = np.radians(angles_deg_2 + rng.uniform(-1, 1, 2) * cfg.jitter_deg)
    distance = cfg.distance_m + rng.uniform(-1, 1) * cfg.jitter_m
    target = np.array(cfg.target_m) + rng.uniform(-1, 1, 3) * cfg.jitter_m
    return look_at(target + distance * direction(elevation, azimuth), target)


def direction(elevation_rad: float, azimuth_rad: float) -> Floats:
    """Unit vector from the target to a camera."""
    level = np.cos(elevation_rad)
    x, y = level * np.cos(azimuth_rad), level * np.sin(azimuth_rad)
    return np.array([x, y, np.sin(elevation_rad)])
