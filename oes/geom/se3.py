"""Rigid motions as 4x4 matrices named ``a_T_b``."""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor

from oes.episode import Floats

Array = TypeVar("Array", Floats, NDArray[np.float32], Tensor)


def rigid(R: Floats, t: Floats) -> Floats:
    """Transform ...44 from rotation ...33 and offset ...3."""
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def inverse(a_T_b: Array) -> Array:
    """``b_T_a`` ...44, by transposing the rotation: exact, unlike a general inverse."""
    b_R_a = a_T_b[..., :3, :3].swapaxes(-1, -2)
    b_T_a = a_T_b.clone() if isinstance(a_T_b, Tensor) else a_T_b.copy()
    b_T_a[..., :3, :3] = b_R_a
    b_T_a[..., :3, 3] = -(b_R_a @ a_T_b[..., :3, 3, None])[..., 0]
    return b_T_a


def transform(a_T_b: Array, points_b: Array) -> Array:
    """Points ...P3 in frame a, of points ...P3 in frame b."""
    return points_b @ a_T_b[..., :3, :3].swapaxes(-1, -2) + a_T_b[..., None, :3, 3]


def rotation_z(angle_rad: float) -> Floats:
    """Rotation 33 about z, counter-clockwise seen from above."""
    return Rotation.from_euler("z", angle_rad).as_matrix()


def quat_xyzw(R: Floats) -> Floats:
    """Quaternions ...4 (real part last, as in Bullet and ROS) of rotations ...33."""
    return Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat().reshape(*R.shape[:-2], 4)


def from_quat_xyzw(quat_xyzw: Floats) -> Floats:
    """Rotations ...33 of quaternions ...4 (real part last)."""
    R = Rotation.from_quat(quat_xyzw.reshape(-1, 4)).as_matrix()
    return R.reshape(*quat_xyzw.shape[:-1], 3, 3)
