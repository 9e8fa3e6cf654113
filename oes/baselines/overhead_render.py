"""Pictures from above, without the arm, which would hide the table: of single states and of whole
episodes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from oes.baselines.clips import Clips
from oes.baselines.overhead_camera import Overhead, OverheadView
from oes.config import Shared, params
from oes.episode import Body, Episode, Step
from oes.meshes.catalogue import Catalogue
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses, scene_meshes
from oes.sim.robot import RobotShape
from oes.sim.world import SimConfig


@params
class OverheadConfig:
    """The section ``frames``: the camera, and the simulated world, for the size of its table."""

    view: OverheadView
    sim: Shared[SimConfig]


class OverheadCamera:
    """Takes pictures (HW3, uint8) of one scene's states."""

    def __init__(
        self,
        catalogue: Catalogue,
        table_size_m: Sequence[float],
        bodies: Sequence[Body],
        cfg: OverheadView,
    ) -> None:
        self._camera = Overhead(cfg).camera
        self._renderer = Renderer(
            scene_meshes(np.array(table_size_m), RobotShape(()), bodies, catalogue)
        )

    def __call__(self, step: Step) -> NDArray[np.uint8]:
        without_arm = replace(step, world_T_link_L44=np.zeros((0, 4, 4)))
        picture: NDArray[np.uint8] = self._renderer.render(
            mesh_poses(without_arm), [self._camera]
        ).rgb_VHW3[0]
        return picture


def make_clips(episodes: Iterable[Episode], catalogue: Catalogue, cfg: OverheadConfig) -> Clips:
    """Pictures of every state of the episodes."""
    overhead, frames, tips, objects = Overhead(cfg.view), [], [], []
    for episode in tqdm(episodes, desc="frames", unit="episode", mininterval=1):
        camera = OverheadCamera(catalogue, cfg.sim.physics.table_size_m, episode.bodies, cfg.view)
        frames.append(np.stack([camera(step).transpose(2, 0, 1) for step in episode.steps]))
        tips.append(overhead.place(np.array([step.tip_world_3 for step in episode.steps])))
        objects.append(overhead.place(np.array([step.center_N3 for step in episode.steps])))
    most = max(each.shape[1] for each in objects)
    padded = np.stack(
        [np.pad(each, ((0, 0), (0, most - each.shape[1]), (0, 0))) for each in objects]
    )
    valid = np.array([[i < each.shape[1] for i in range(most)] for each in objects])
    return Clips(
        torch.from_numpy(np.stack(frames)),
        torch.from_numpy(np.stack(tips)).float(),
        torch.from_numpy(padded).float(),
        torch.from_numpy(valid),
    )
