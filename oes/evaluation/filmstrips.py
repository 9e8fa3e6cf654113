"""Film strips: an episode's states side by side, recorded above and forecast below."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from oes.episode import Camera, Episode
from oes.episodes.capture import scene_renderer
from oes.evaluation.forecasters import Forecaster, RolloutsConfig, forecast_steps, perceived_scenes
from oes.geom.camera import intrinsics, look_at
from oes.meshes.catalogue import Catalogue
from oes.perception.objects_file import ObjectStore
from oes.render.scene import mesh_poses
from oes.sim.rig import direction


def render_filmstrips(
    forecaster: Forecaster,
    store: ObjectStore,
    episodes: Mapping[int, Episode],
    catalogue: Catalogue,
    cfg: RolloutsConfig,
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Episode indices and images of I square tiles by two rows (uint8 RGB)."""
    scenes = perceived_scenes(store, cfg.filmstrips.setting, episodes)[: cfg.filmstrips.count]
    camera = _camera(cfg)
    for scene, forecast in zip(scenes, forecaster(scenes, episodes), strict=True):
        episode = episodes[scene.episode_i]
        renderer = scene_renderer(episode, catalogue, cfg.sim)
        rows = [
            np.hstack([renderer.render(mesh_poses(step), [camera]).rgb_VHW3[0] for step in steps])
            for steps in (episode.steps, forecast_steps(episode, forecast))
        ]
        yield scene.episode_i, np.vstack(rows)


def _camera(cfg: RolloutsConfig) -> Camera:
    strips, rig = cfg.filmstrips, cfg.sim.rig
    angles = np.radians(strips.elevation_deg), np.radians(strips.azimuth_deg)
    target = np.array(rig.target_m)
    world_T_cam = look_at(target + rig.distance_m * direction(*angles), target)
    K_33 = intrinsics(strips.fov_deg, strips.size_px, strips.size_px)
    return Camera("filmstrip", K_33, world_T_cam, strips.size_px, strips.size_px)
