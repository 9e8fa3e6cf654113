"""Shapes drawn at their projections, and videos that play."""

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from oes.episode import Camera
from oes.geom.camera import intrinsics, look_at
from oes.viz.overlay import GOAL, PERCEIVED, CameraOverlay
from oes.viz.video import write_gif, write_video

CAMERA = Camera(
    "cam", intrinsics(42.0, 64, 64), look_at(np.array([0.9, 0.0, 0.5]), np.zeros(3)), 64, 64
)
BLACK = np.zeros((64, 64, 3), np.uint8)


def _drawn(image: CameraOverlay) -> tuple[float, float]:
    """Centre (u, v) of the drawn pixels, in pixels of the camera image."""
    v, u = np.nonzero(image.pixels.any(axis=2))
    return u.mean() / image.zoom, v.mean() / image.zoom


def test_shapes_are_drawn_where_they_project() -> None:
    for move, place in (
        ((0, 0, 0), (32, 32)),
        ((0, 0.2, 0), (48.2, 32)),
        ((0, 0, 0.2), (32, 16.3)),
    ):
        image = CameraOverlay(BLACK, CAMERA, 4)
        image.box(np.array(move, float), np.full(3, 0.05), PERCEIVED)
        assert _drawn(image) == pytest.approx(place, abs=1.5)
        assert tuple(image.pixels.reshape(-1, 3).max(axis=0)) == PERCEIVED
    ring = CameraOverlay(BLACK, CAMERA, 4)
    ring.ring(np.zeros(3), 0.1, GOAL)
    assert _drawn(ring) == pytest.approx((32, 32), abs=1.5)
    assert not ring.pixels[128 - 4 : 128 + 4, 128 - 4 : 128 + 4].any(), "a ring is hollow"


def test_shapes_behind_the_camera_are_not_drawn() -> None:
    image = CameraOverlay(BLACK, CAMERA, 2)
    image.box(np.array([2.0, 0.0, 0.8]), np.full(3, 0.05), PERCEIVED)
    assert not image.pixels.any()


def test_videos_hold_their_frames_and_repeat_their_bytes(tmp_path: Path) -> None:
    frames = [np.full((64, 96, 3), level, np.uint8) for level in (0, 128, 255)]
    for name in ("a", "b"):
        write_video(frames, tmp_path / f"{name}.mp4", 5)
        write_gif([(pixels, 0.4) for pixels in frames], tmp_path / f"{name}.gif")
    for suffix in ("mp4", "gif"):
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()
    with av.open(str(tmp_path / "a.mp4")) as container:
        levels = [frame.to_ndarray(format="rgb24").mean() for frame in container.decode(video=0)]
        assert container.streams.video[0].codec_context.name == "h264"
    assert levels == pytest.approx([0, 128, 255], abs=4)
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == 3 and gif.info["duration"] == 400
