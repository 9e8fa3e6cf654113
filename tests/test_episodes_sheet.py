"""Contact sheets: whole, self-contained, and drawn where things are."""

import re
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from oes.episode import Episode
from oes.episodes.index import write_index
from oes.episodes.motion import contact_pairs, displacement_mm
from oes.episodes.sheet import (
    OBJECT_COLOURS,
    charts,
    depth_image,
    draw_boxes,
    main,
    mosaic,
    seg_image,
)
from oes.record import EpisodeError, read_episode, write_episode
from oes.record.dataset import read_states
from tests.factories import make_episode, make_frames


class Page(HTMLParser):
    """The cells, links and images (caption, pixels) of a page, as a browser would parse it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.html = path.read_text(encoding="utf-8")
        self.tags: list[str] = []
        self.texts: dict[str, list[str]] = {}
        self.links: list[str] = []
        self.images: list[tuple[str, np.ndarray]] = []
        self.feed(self.html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append(tag)
        if tag == "a":
            self.links.append(str(given["href"]))
        if tag == "img":
            kind, data = re.fullmatch(r"data:image/(\w+);base64,(.*)", str(given["src"])).groups()
            image = Image.open(BytesIO(b64decode(data)))
            assert image.format.lower() == kind
            self.images.append((str(given["alt"]), np.asarray(image.convert("RGB"))))

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.setdefault(self.tags[-1], []).append(data.strip())


def write_split(folder: Path, count: int) -> None:
    for index in range(count):
        episode = make_episode(seed=index)
        bodies = tuple(replace(body, mesh=f"<i>{body.mesh}&$^$") for body in episode.bodies)
        write_episode(
            replace(episode, bodies=bodies), make_frames(episode), folder / f"traj_{index:06d}"
        )


def test_sheet_shows_every_layer_of_every_state_and_needs_nothing_else(tmp_path: Path) -> None:
    write_split(tmp_path, 1)
    assert main([str(tmp_path / "traj_000000"), "--out", str(tmp_path / "sheet.html")]) == 0
    page = Page(tmp_path / "sheet.html")
    episode, frames = read_episode(tmp_path / "traj_000000"), make_frames(make_episode())
    assert len(page.images) == 1 + 3 * 3
    assert not {"link", "i"} & set(page.tags) and "http" not in page.html
    assert f"1 {episode.bodies[0].mesh}" in page.texts["td"]
    assert "&lt;i&gt;mesh_0&amp;" in page.html
    for step_i, (step, views) in enumerate(zip(episode.steps, frames, strict=True)):
        layers = page.images[1 + 3 * step_i : 4 + 3 * step_i]
        for (caption, image), name in zip(layers, ("colour", "depth", "segm"), strict=True):
            assert caption.startswith(f"State {step_i}: {name}")
            assert image.shape == (96, 288, 3)
        boxed = views.rgb_VHW3.copy()
        for image, camera in zip(boxed, step.cameras, strict=True):
            draw_boxes(image, camera, step.center_N3, step.size_N3)
        assert (boxed != views.rgb_VHW3).any(axis=(1, 2, 3)).all()
        shown, *drawn = (
            image.reshape(3, 32, 288, 3)[:, 10:].ravel()  # below the camera's name
            for image in (layers[0][1], mosaic(boxed), mosaic(views.rgb_VHW3))
        )
        with_boxes, without = (np.corrcoef(shown, image)[0, 1] for image in drawn)
        assert with_boxes > 0.85 and with_boxes > without  # of a JPEG of noise
        assert np.array_equal(layers[2][1], mosaic(seg_image(views.seg_VHW)))


def test_boxes_are_drawn_where_the_cameras_see_them() -> None:
    """Every camera of the factory looks at (0, 0, 0.1), where a small cube is drawn in the middle
    of each view.
    """
    cameras = make_episode(size_px=128).steps[0].cameras
    center, size = np.array([[0.0, 0.0, 0.1]]), np.full((1, 3), 0.05)
    for camera in cameras:
        image = np.zeros((128, 128, 3), np.uint8)
        draw_boxes(image, camera, center, size)
        pixels = np.argwhere(image.any(axis=-1))
        assert len(pixels) > 30
        assert np.abs(pixels - 64).max() < 10
        assert np.abs(pixels.mean(axis=0) - 63.5).max() < 2
    behind = replace(cameras[0], world_T_cam_44=np.eye(4))
    image = np.zeros((128, 128, 3), np.uint8)
    draw_boxes(image, behind, np.array([[0.0, 0.0, -1.0]]), size)
    assert not image.any()


def test_mosaic_puts_each_view_in_its_place() -> None:
    images = np.arange(27, dtype=np.uint8)[:, None, None, None] * np.ones((1, 4, 6, 3), np.uint8)
    whole = mosaic(images)
    assert whole.shape == (12, 54, 3)
    for view_i in range(27):
        row, column = divmod(view_i, 9)
        x, y = 6 * column, 4 * (2 - row)
        assert (whole[y : y + 4, x : x + 6] == view_i).all()


def test_images_of_depth_and_segmentation() -> None:
    depth = np.array([[[0.0, 1.0, 2.0]]], np.float32)
    image = depth_image(depth, 1.0, 2.0)[0, 0].tolist()
    assert image[0] == [255, 255, 255]
    assert sum(image[1]) > sum(image[2])
    ids = seg_image(np.array([[[0, 1, 2, 3, 4]]], np.uint8))[0, 0]
    assert len({tuple(color) for color in ids.tolist()}) == 5


def moved_episode() -> Episode:
    """Two states, in the second of which object 1 has moved and the rod has touched it."""
    episode = make_episode(num_objects=2)
    first = episode.steps[0]
    moved = first.world_T_obj_N44.copy()
    moved[1, :3, 3] += [0.03, 0.0, 0.04]
    contact = np.zeros((4, 4), bool)
    contact[1, 3] = contact[3, 1] = contact[0, 2] = contact[2, 0] = True
    steps = (
        replace(first, contact_AA=contact & False),
        replace(first, t_ns=1, world_T_obj_N44=moved, contact_AA=contact),
    )
    return replace(episode, steps=steps, actions_T3=episode.actions_T3[:1])


def test_displacement_and_contacts() -> None:
    short = moved_episode()
    np.testing.assert_allclose(displacement_mm(short, 0), [0, 0], atol=1e-9)
    np.testing.assert_allclose(displacement_mm(short, 1), [0, 50], atol=1e-9)
    assert contact_pairs(short) == [(1, 3)]


def test_charts_show_the_objects_and_their_contacts() -> None:
    """Object 1 alone has a bar of contact, in its colour; both objects are in the other charts."""
    image = charts(moved_episode())

    def count(colour: str, part: np.ndarray) -> int:
        return int((np.abs(part - 255 * np.array(to_rgb(colour))).max(axis=-1) < 2).sum())

    above, displacement, contacts = np.array_split(image, 3, axis=1)
    assert count("#111111", above) > 20
    for colour in OBJECT_COLOURS[:2]:
        assert count(colour, above) > 20 and count(colour, displacement) > 20
    assert count(OBJECT_COLOURS[0], contacts) == 0
    assert count(OBJECT_COLOURS[1], contacts) > 1000


def test_index_has_a_row_per_episode_and_links_to_the_sheets_that_exist(tmp_path: Path) -> None:
    write_split(tmp_path, 4)
    episodes = read_states(tmp_path)
    write_index(tmp_path, episodes, camera_i=13, num_sheets=2)
    page = Page(tmp_path / "index.html")
    assert page.tags.count("tr") == 1 + 4
    assert page.links == ["sheets/traj_000000.html", "sheets/traj_000001.html"]
    for link in page.links:
        assert any(name == "State 2: segmentation" for name, _ in Page(tmp_path / link).images)
    assert [image.shape for _, image in page.images] == [(64, 3 * 64, 3)] * 4
    assert page.texts["a"] == ["traj_000000", "traj_000001"]
    assert "i" not in page.tags and "&lt;i&gt;mesh_1&amp;" in page.html
    most_mm = [f"{displacement_mm(episode, 2).max():.0f}" for episode in episodes]
    assert set(most_mm) <= set(page.texts["td"])
    bag = tmp_path / "traj_000003" / "traj_000003_0.mcap"
    bag.write_bytes(b"")
    with pytest.raises(EpisodeError, match="traj_000003_0"):
        write_index(tmp_path, episodes, camera_i=13, num_sheets=0)


def test_index_depends_on_the_episodes_alone(tmp_path: Path) -> None:
    """Its heading is the task and split, not the folder, which while made is named by a digest."""
    for name in ("0123456789abcdef", "fedcba9876543210"):
        write_split(tmp_path / name, 2)
        write_index(tmp_path / name, read_states(tmp_path / name), camera_i=13, num_sheets=1)
    one, other = (
        tmp_path / name / "index.html" for name in ("0123456789abcdef", "fedcba9876543210")
    )
    assert Page(one).texts["h1"] == ["pushing-train"]
    assert "0123456789abcdef" not in one.read_text()
    assert one.read_bytes() == other.read_bytes()
    sheet = Path("sheets/traj_000000.html")
    assert (one.parent / sheet).read_bytes() == (other.parent / sheet).read_bytes()


def test_pages_of_an_episode_without_objects_or_robot(tmp_path: Path) -> None:
    episode = make_episode(num_objects=0, num_steps=2)
    steps = [replace(step, joints_rad_J=np.zeros(0)) for step in episode.steps]
    folder = tmp_path / "traj_000000"
    write_episode(replace(episode, steps=tuple(steps)), make_frames(episode), folder)
    write_index(tmp_path, read_states(tmp_path), camera_i=0, num_sheets=1)
    page = Page(tmp_path / "sheets/traj_000000.html")
    assert len(page.images) == 1 + 2 * 3
    assert page.texts["h2"] == ["Objects"]
    assert "0 objects, 2 states" in page.html and "no robot" in page.html
    assert Page(tmp_path / "index.html").texts["td"] == ["0", "0", "0"]


def test_an_expected_error_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert main([str(tmp_path / "traj_000000")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("sheet: ") and "traj_000000" in error and error.count("\n") == 1
