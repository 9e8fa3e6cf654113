"""Overhead images of single states and of whole episodes. The arm is removed; it would occlude."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from oes.baselines.clips import Clips
from oes.baselines.overhead_camera import OverheadCamera, OverheadView
from oes.config import Shared, params
from oes.episode import Body, Episode, Step
from oes.meshes.catalogue import Catalogue
from oes.progress import progress_bar
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses, scene_meshes
from oes.sim.robot import RobotShape
from oes.sim.world import SimConfig


@params
class OverheadConfig:
    """The section ``overhead``: the camera, and the simulation (for the size of its table)."""

    view: OverheadView
    sim: Shared[SimConfig]


class OverheadRenderer:
    """Renders the states of one scene as HW3 uint8 images."""

    def __init__(
        self,
        catalogue: Catalogue,
        table_size_m: Sequence[float],
        bodies: Sequence[Body],
        view: OverheadView,
    ) -> None:
        self._camera = OverheadCamera(view).camera
        meshes = scene_meshes(np.array(table_size_m), RobotShape(()), bodies, catalogue)
        self._renderer = Renderer(meshes)

    def __call__(self, step: Step) -> NDArray[np.uint8]:
        poses = mesh_poses(replace(step, world_T_link_L44=np.zeros((0, 4, 4))))
        image: NDArray[np.uint8] = self._renderer.render(poses, [self._camera]).rgb_VHW3[0]
        return image


def make_clips(episodes: Sequence[Episode], catalogue: Catalogue, cfg: OverheadConfig) -> Clips:
    """Render every state of the episodes. All episodes have the same number of states."""
    camera, clips = OverheadCamera(cfg.view), []
    table_m = cfg.sim.physics.table_size_m
    bar = progress_bar(episodes, total=len(episodes), desc="rendering", unit="episode")
    for episode in bar:
        render = OverheadRenderer(catalogue, table_m, episode.bodies, cfg.view)
        images = np.stack([render(step).transpose(2, 0, 1) for step in episode.steps])
        tips = camera.project(np.array([step.tip_world_3 for step in episode.steps]))
        objects = camera.project(np.array([step.center_N3 for step in episode.steps]))
        clips.append((images, tips, objects))
    images_B, tips_B, objects_B = zip(*clips, strict=True)
    num_N = [objects.shape[1] for objects in objects_B]
    padded = [np.pad(x, ((0, 0), (0, max(num_N) - x.shape[1]), (0, 0))) for x in objects_B]
    return Clips(
        torch.from_numpy(np.stack(images_B)),
        torch.from_numpy(np.stack(tips_B)).float(),
        torch.from_numpy(np.stack(padded)).float(),
        torch.from_numpy(np.arange(max(num_N)) < np.array(num_N)[:, None]),
    )
