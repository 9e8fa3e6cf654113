"""The data types that all stages share: Camera, Body, Step, Frames, Episode."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Pixels = NDArray[np.uint8]

PUSHING, FALLING = "pushing", "falling"  # the tasks
TASKS = (PUSHING, FALLING)

SEG_NOTHING, SEG_TABLE, SEG_ROBOT, SEG_FIRST_OBJECT = 0, 1, 2, 3
TABLE, ROBOT, FIRST_OBJECT = 0, 1, 2  # rows of Step.contact_AA


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with intrinsics ``K_33`` (cam to pix frame) and pose ``world_T_cam_44``."""

    name: str
    K_33: Floats
    world_T_cam_44: Floats
    width_px: int
    height_px: int


@dataclass(frozen=True)
class Body:
    """One object of an episode: a catalogue mesh scaled along its own axes, physics and texture."""

    mesh: str
    category: str
    scale_3: Floats
    mass_kg: float
    friction: float
    texture_seed: int


@dataclass(frozen=True)
class Step:
    """The true state of the world at one recorded instant.

    ``center_N3`` and ``size_N3`` are the axis-aligned bounding box (world axes) of each posed mesh.
    ``contact_AA`` is the contact matrix of the A = N + 2 bodies (table, robot, objects in order):
    True if two were in contact since the previous recorded state; all False at the first state.
    Without a robot the tip is NaN, and J and L are 0.
    """

    t_ns: int
    world_T_obj_N44: Floats
    center_N3: Floats
    size_N3: Floats
    tip_world_3: Floats
    joints_rad_J: Floats
    world_T_link_L44: Floats
    contact_AA: Bools
    cameras: tuple[Camera, ...]


@dataclass(frozen=True)
class Frames:
    """Images of one state from V cameras: RGB, z-depth (m, 0 = no return), segmentation ids."""

    rgb_VHW3: NDArray[np.uint8]
    depth_m_VHW: NDArray[np.float32]
    seg_VHW: NDArray[np.uint8]

    def of(self, camera_is: Sequence[int]) -> "Frames":
        """The images of the given cameras, in that order."""
        views = list(camera_is)
        return Frames(self.rgb_VHW3[views], self.depth_m_VHW[views], self.seg_VHW[views])


@dataclass(frozen=True)
class Episode:
    """One trajectory: T + 1 states and the T actions (horizontal tip displacements, m) between.

    ``rod_rms_m`` is the RMS distance of the rod's tip from its commanded path over all simulation
    steps. Without a robot it is NaN and the actions are 0.
    """

    task: str
    split: str
    index: int
    seed: int
    bodies: tuple[Body, ...]
    actions_T3: Floats
    steps: tuple[Step, ...]
    rod_rms_m: float

    @property
    def has_robot(self) -> bool:
        """Whether the episode has an arm; falling episodes have none."""
        return len(self.steps[0].joints_rad_J) > 0
