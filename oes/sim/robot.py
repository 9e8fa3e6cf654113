"""The robot, a Kuka iiwa with a vertical rod on a pedestal, as a URDF and as triangles."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pybullet_data
import trimesh
from numpy.typing import NDArray

from oes.config import params
from oes.episode import Floats

KUKA = Path(pybullet_data.getDataPath()) / "kuka_iiwa" / "model.urdf"
NUM_JOINTS = 7
FLANGE_M = 0.045  # frame of link 7 to the face that holds the rod
ROD_MASS_KG = 0.05
ROD_RGB = (0.75, 0.1, 0.1)

Triangles = tuple[Floats, NDArray[np.int32], Floats]  # vertices P3, faces F3, rgb 3


@params
class RobotConfig:
    """Placement of the arm and size of its rod, which extends straight from the flange.

    ``base_m``: origin of the arm's base, world.
    ``tip_height_m``: height of the rod's tip above the table.
    ``workspace_m``: largest |x| and |y| of the tip.
    """

    base_m: tuple[float, float, float]
    pedestal_m: float
    rod_length_m: float
    rod_radius_m: float
    tip_height_m: float
    workspace_m: float


@dataclass(frozen=True)
class RobotShape:
    """Triangles of every link in the order of world_T_link_L44: base, seven links, rod.

    The origin of the rod's frame is the centre of its tip.
    """

    links: tuple[Triangles, ...]


def write_urdf(cfg: RobotConfig, folder: Path) -> Path:
    """Write pybullet's iiwa with a pedestal below its base and the rod as a fixed last link."""
    root = ET.parse(KUKA).getroot()
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(KUKA.parent / mesh.attrib["filename"]))
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)  # Bullet renders nothing here
    center = f"0 0 {-cfg.rod_length_m / 2}"
    for element in (
        # The rod's frame has its origin at the tip, +z out of it. A fixed joint cannot bend.
        f'<link name="rod"><inertial><origin xyz="{center}"/><mass value="{ROD_MASS_KG}"/>'
        f'<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-5"/></inertial>'
        f'<collision><origin xyz="{center}"/><geometry><cylinder radius="{cfg.rod_radius_m}" '
        f'length="{cfg.rod_length_m}"/></geometry></collision></link>',
        f'<joint name="rod_joint" type="fixed"><parent link="lbr_iiwa_link_7"/>'
        f'<child link="rod"/><origin xyz="0 0 {FLANGE_M + cfg.rod_length_m}"/></joint>',
    ):
        root.append(ET.fromstring(element))
    x, y, z = _pedestal_center(cfg)
    size = f"{cfg.pedestal_m} {cfg.pedestal_m} {cfg.base_m[2]}"
    pedestal = (
        f'<collision><origin xyz="{x} {y} {z}"/>'
        f'<geometry><box size="{size}"/></geometry></collision>'
    )
    _child(root, "link[@name='lbr_iiwa_link_0']").append(ET.fromstring(pedestal))
    path = folder / "kuka_rod.urdf"
    ET.ElementTree(root).write(path)
    return path


@lru_cache(maxsize=2)
def robot_shape(cfg: RobotConfig) -> RobotShape:
    """Triangles of the base with its pedestal, the seven links and the rod, in their frames."""
    root = ET.parse(KUKA).getroot()
    rgbs = {
        material.attrib["name"]: np.array(
            [float(number) for number in _child(material, "color").attrib["rgba"].split()]
        )[:3]
        for material in root.findall("material")
    }
    links = []
    for link in root.findall("link"):
        mesh = _child(link, "visual/geometry/mesh").attrib["filename"]
        rgb = rgbs[_child(link, "visual/material").attrib["name"]]
        links.append(_triangles(trimesh.load_mesh(KUKA.parent / mesh), rgb))
    vertices, faces, rgb = links[0]
    pedestal = trimesh.creation.box((cfg.pedestal_m, cfg.pedestal_m, cfg.base_m[2]))
    pedestal.apply_translation(_pedestal_center(cfg))
    faces = np.concatenate([faces, np.asarray(pedestal.faces, np.int32) + len(vertices)])
    links[0] = np.concatenate([vertices, pedestal.vertices]), faces, rgb
    rod = trimesh.creation.cylinder(cfg.rod_radius_m, cfg.rod_length_m, sections=24)
    rod.apply_translation([0, 0, -cfg.rod_length_m / 2])
    return RobotShape((*links, _triangles(rod, np.array(ROD_RGB))))


def _triangles(mesh: trimesh.Trimesh, rgb: Floats) -> Triangles:
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), rgb


def _pedestal_center(cfg: RobotConfig) -> list[float]:
    """In the base's frame: on the plane of the table top, the far side flush with the base's."""
    return [-cfg.pedestal_m / 4, 0.0, -cfg.base_m[2] / 2]


def _child(parent: ET.Element, path: str) -> ET.Element:
    child = parent.find(path)
    if child is None:
        raise ValueError(f"{KUKA}: {parent.tag} {parent.attrib} has no {path}")
    return child
