"""Contact sheets: whole, self-contained, and drawn where things are."""

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from oes.record import EpisodeError, write_episode
from oes.record.charts import contact_pairs, displacement_mm, plan_svg
from oes.record.index import write_index
from oes.record.pictures import box_path, depth_picture, mosaic, place, seg_picture
from oes.record.sheet import episode_sheet, main
from tests.factories import make_episode, make_frames


def write_split(folder: Path, count: int) -> None:
    for index in range(count):
        episode = make_episode(seed=index)
        bodies = tuple(replace(body, mesh=f"<i>{body.mesh}&") for body in episode.bodies)
        write_episode(
            replace(episode, bodies=bodies), make_frames(episode), folder / f"traj_{index:06d}"
        )


def test_sheet_shows_every_layer_of_every_state_and_needs_nothing_else(tmp_path: Path) -> None:
    write_split(tmp_path, 1)
    assert main([str(tmp_path / "traj_000000"), "--out", str(tmp_path / "sheet.html")]) == 0
    html = (tmp_path / "sheet.html").read_text()
    shown = re.findall(
        r'<img data-step="(\d)" data-layer="(\w+)" src="data:image/(\w+);base64,', html
    )
    formats = {"colour": "jpeg", "depth": "jpeg", "segmentation": "png"}
    assert sorted(shown) == sorted(
        (str(i), layer, kind) for i in range(3) for layer, kind in formats.items()
    )
    assert "http" not in html and "<link" not in html
    assert "&lt;i&gt;mesh_0&amp;" in html and "<i>mesh_0" not in html
    drawings = [
        ElementTree.fromstring(svg) for svg in re.findall(r"<svg.*?</svg>", html, re.DOTALL)
    ]
    assert len(drawings) == 4
    assert len(drawings[0].findall("g[@class='boxes']")) == 3
    assert all(len(group.findall("path")) == 2 for group in drawings[0].findall("g"))


def test_boxes_are_drawn_where_the_cameras_see_them() -> None:
    """Every camera of the factory looks at (0, 0, 0.1): a small cube there lies around the middle
    of each view.
    """
    cameras = make_episode(size_px=128).steps[0].cameras
    for view_i, camera in enumerate(cameras):
        corner = np.array(place(view_i, len(cameras), (128, 128)))
        path = box_path(camera, (corner[0], corner[1]), np.array([0.0, 0.0, 0.1]), np.full(3, 0.05))
        xy = np.array(re.findall(r"(\d+) (\d+)", path), float)
        assert len(xy) == 24
        assert np.abs(xy - corner - 64).max() < 10
    behind = replace(cameras[0], world_T_cam_44=np.eye(4))
    assert box_path(behind, (0, 0), np.array([0.0, 0.0, -1.0]), np.full(3, 0.05)) == ""


def test_mosaic_puts_each_view_in_its_place() -> None:
    images = np.arange(27, dtype=np.uint8)[:, None, None, None] * np.ones((1, 4, 6, 3), np.uint8)
    whole = mosaic(images)
    assert whole.shape == (12, 54, 3)
    for view_i in range(27):
        x, y = place(view_i, 27, (6, 4))
        assert (whole[y : y + 4, x : x + 6] == view_i).all()
    assert place(26, 27, (6, 4)) == (48, 0)


def test_pictures_of_depth_and_segmentation() -> None:
    depth = np.array([[[0.0, 1.0, 2.0]]], np.float32)
    picture = depth_picture(depth, 1.0, 2.0)[0, 0].tolist()
    assert picture[0] == [255, 255, 255]
    assert sum(picture[1]) > sum(picture[2])
    ids = seg_picture(np.array([[[0, 1, 2, 3, 4]]], np.uint8))[0, 0]
    assert len({tuple(color) for color in ids.tolist()}) == 5


def test_displacement_and_contacts() -> None:
    episode = make_episode(num_objects=2)
    first = episode.steps[0]
    moved = first.world_T_obj_N44.copy()
    moved[1, :3, 3] += [0.03, 0.0, 0.04]
    touched = np.zeros((4, 4), bool)
    touched[1, 3] = touched[3, 1] = touched[0, 2] = touched[2, 0] = True
    steps = (
        replace(first, contact_AA=touched & False),
        replace(first, t_ns=1, world_T_obj_N44=moved, contact_AA=touched),
    )
    short = replace(episode, steps=steps, actions_T3=episode.actions_T3[:1])
    np.testing.assert_allclose(displacement_mm(short), [[0, 0], [0, 50]], atol=1e-9)
    assert contact_pairs(short) == [(1, 3)]
    plan = ElementTree.fromstring(plan_svg(short))
    assert len(plan.findall("rect[@class='hull']")) == 4


def test_index_has_a_row_per_episode_and_links_to_the_sheets_that_exist(tmp_path: Path) -> None:
    write_split(tmp_path, 4)
    write_index(tmp_path, camera_i=13, num_sheets=2)
    html = (tmp_path / "index.html").read_text()
    assert len(re.findall(r"<tr><td", html)) == 4
    links = re.findall(r'href="([^"]+)"', html)
    assert links == ["sheets/traj_000000.html", "sheets/traj_000001.html"]
    assert all("segmentation of state 2" in (tmp_path / link).read_text() for link in links)
    assert len(re.findall(r'<img width="192"', html)) == 4
    bag = tmp_path / "traj_000003" / "traj_000003_0.mcap"
    bag.write_bytes(b"")
    with pytest.raises(EpisodeError, match="traj_000003_0"):
        write_index(tmp_path, camera_i=13, num_sheets=0)


def test_sheet_of_an_episode_without_objects(tmp_path: Path) -> None:
    episode = make_episode(num_objects=0, num_steps=2)
    write_episode(episode, make_frames(episode), tmp_path / "traj_000000")
    assert "none between objects" in episode_sheet(tmp_path / "traj_000000")
