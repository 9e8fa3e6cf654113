"""The robot: a Kuka iiwa on a pedestal with a vertical rod, as a URDF for Bullet and as triangles
for the renderer.
"""

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
FLANGE_M = 0.045  # from the frame of link 7 to the face the rod is screwed to
ROD_MASS_KG = 0.05
ROD_RGB = (0.75, 0.1, 0.1)


@params
class RobotConfig:
    """Where the arm stands (its base frame in world axes), what it holds (a rod straight out of the
    flange, whose tip travels at ``tip_height_m`` above the table) and the square +- ``workspace_m``
    of the table that the tip may visit.
    """

    base_m: tuple[float, float, float]
    pedestal_m: float
    rod_length_m: float
    rod_radius_m: float
    tip_height_m: float
    workspace_m: float


@dataclass(frozen=True)
class RobotShape:
    """What the renderer draws: (vertices P3, faces F3, rgb 3) of every link, in the order of
    world_T_link_L44.

    The links are the seven of the arm after its base, and last the rod, whose frame's origin is the
    tip's centre.
    """

    links: tuple[tuple[Floats, NDArray[np.int32], Floats], ...]


def write_urdf(cfg: RobotConfig, folder: Path) -> Path:
    """pybullet's iiwa with the rod as a fixed last link (so that it cannot bend) and a pedestal
    under its base.
    """
    root = ET.parse(KUKA).getroot()
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(KUKA.parent / mesh.attrib["filename"]))
    for link in root.iter("link"):
        for visual in link.findall("visual"):
            link.remove(visual)  # nothing is drawn by Bullet
    root.append(_rod_link(cfg))
    root.append(_rod_joint(cfg))
    _add_pedestal(root, cfg)
    path = folder / "kuka_rod.urdf"
    ET.ElementTree(root).write(path)
    return path


@lru_cache(maxsize=2)
def robot_shape(cfg: RobotConfig) -> RobotShape:
    """Triangles of the base (with its pedestal), the seven links and the rod, each in its link's
    frame.
    """
    root = ET.parse(KUKA).getroot()
    rgbs = {m.attrib["name"]: _numbers(m, "color", "rgba")[:3] for m in root.findall("material")}
    links = [_link_shape(link, rgbs) for link in root.findall("link")]
    rod = trimesh.creation.cylinder(cfg.rod_radius_m, cfg.rod_length_m, sections=24)
    rod.apply_translation([0, 0, -cfg.rod_length_m / 2])
    return RobotShape(
        (_with_pedestal(links[0], cfg), *links[1:], _triangles(rod, np.array(ROD_RGB)))
    )


def _link_shape(
    link: ET.Element, rgbs: dict[str, Floats]
) -> tuple[Floats, NDArray[np.int32], Floats]:
    mesh, material = link.find("visual/geometry/mesh"), link.find("visual/material")
    if mesh is None or material is None:
        raise ValueError(f"{KUKA}: link {link.attrib['name']} has no visual mesh with a material")
    shape = trimesh.load_mesh(KUKA.parent / mesh.attrib["filename"])
    return _triangles(shape, rgbs[material.attrib["name"]])


def _triangles(mesh: trimesh.Trimesh, rgb: Floats) -> tuple[Floats, NDArray[np.int32], Floats]:
    return np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32), rgb


def _with_pedestal(
    base: tuple[Floats, NDArray[np.int32], Floats], cfg: RobotConfig
) -> tuple[Floats, NDArray[np.int32], Floats]:
    vertices, faces, rgb = base
    block = trimesh.creation.box((cfg.pedestal_m, cfg.pedestal_m, cfg.base_m[2]))
    block.apply_translation(_pedestal_center(cfg))
    faces = np.concatenate([faces, np.asarray(block.faces, np.int32) + len(vertices)])
    return np.concatenate([vertices, block.vertices]), faces, rgb


def _pedestal_center(cfg: RobotConfig) -> list[float]:
    """The pedestal stands on the plane of the table top; its far side ends where the base's
    does.
    """
    return [-cfg.pedestal_m / 4, 0.0, -cfg.base_m[2] / 2]


def _rod_link(cfg: RobotConfig) -> ET.Element:
    """The rod's frame: origin at the tip's centre, +z pointing out of the tip."""
    middle = f"0 0 {-cfg.rod_length_m / 2}"
    cylinder = (
        f'<geometry><cylinder radius="{cfg.rod_radius_m}" length="{cfg.rod_length_m}"/></geometry>'
    )
    return ET.fromstring(
        f'<link name="rod"><inertial><origin xyz="{middle}"/><mass value="{ROD_MASS_KG}"/>'
        f'<inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-5"/></inertial>'
        f'<collision><origin xyz="{middle}"/>{cylinder}</collision></link>'
    )


def _rod_joint(cfg: RobotConfig) -> ET.Element:
    return ET.fromstring(
        f'<joint name="rod_joint" type="fixed"><parent link="lbr_iiwa_link_7"/><child link="rod"/>'
        f'<origin xyz="0 0 {FLANGE_M + cfg.rod_length_m}"/></joint>'
    )


def _add_pedestal(root: ET.Element, cfg: RobotConfig) -> None:
    base = root.find("link[@name='lbr_iiwa_link_0']")
    if base is None:
        raise ValueError(f"{KUKA} has no link lbr_iiwa_link_0")
    x, y, z = _pedestal_center(cfg)
    size = f"{cfg.pedestal_m} {cfg.pedestal_m} {cfg.base_m[2]}"
    base.append(
        ET.fromstring(
            f'<collision><origin xyz="{x} {y} {z}"/><geometry><box size="{size}"/></geometry></collision>'
        )
    )


def _numbers(parent: ET.Element, tag: str, key: str) -> Floats:
    child = parent.find(tag)
    if child is None:
        raise ValueError(f"{KUKA}: {parent.attrib} has no {tag}")
    return np.array([float(word) for word in child.attrib[key].split()])
