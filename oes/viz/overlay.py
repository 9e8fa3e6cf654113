"""Pictures of what was seen, believed and planned, drawn in a camera's view, and the video file
that holds them.
"""

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import product
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from oes.episode import Camera, Floats
from oes.geom.camera import project

Pixels = NDArray[np.uint8]
Colour = tuple[int, int, int]

# Okabe and Ito's palette, told apart by colour-blind eyes: seen, imagined, goal, push.
SEEN: Colour = (0, 114, 178)
IMAGINED: Colour = (230, 159, 0)
GOAL: Colour = (0, 158, 115)
PUSH: Colour = (213, 94, 0)
INK: Colour = (255, 255, 255)

_CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))
_EDGES = [
    (a, b) for a in range(8) for b in range(a) if np.abs(_CORNERS[a] - _CORNERS[b]).sum() == 1
]


class CameraOverlay:
    """An enlarged photograph on which world-frame shapes are drawn. ``pixels`` is the picture, H W
    3.
    """

    def __init__(self, rgb_HW3: Pixels, camera: Camera, zoom: int) -> None:
        self.camera, self.zoom = camera, zoom
        self.pixels: Pixels = np.ascontiguousarray(
            rgb_HW3.repeat(zoom, axis=0).repeat(zoom, axis=1)
        )

    def line(self, points_P3: Floats, rgb: Colour) -> None:
        """A polyline through world points; nothing where any of it is behind the camera."""
        uv_P2, depth_P = project(self.camera.K_33, self.camera.world_T_cam_44, points_P3)
        if (depth_P > 0).all():
            corners = np.rint(np.clip(uv_P2 * self.zoom, -1e4, 1e4)).astype(np.int32)
            cv2.polylines(self.pixels, [corners], False, rgb, max(1, self.zoom // 2), cv2.LINE_AA)

    def box(self, center_3: Floats, size_3: Floats, rgb: Colour) -> None:
        """The twelve edges of an axis-aligned box in metres."""
        corners = center_3 + size_3 * _CORNERS
        for a, b in _EDGES:
            self.line(corners[[a, b]], rgb)

    def ring(self, center_3: Floats, radius_m: float, rgb: Colour) -> None:
        """A horizontal circle."""
        angle = np.linspace(0, 2 * np.pi, 33)
        self.line(
            center_3 + radius_m * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), rgb
        )

    def arrow(self, start_3: Floats, displacement_3: Floats, rgb: Colour) -> None:
        """A horizontal arrow with barbs a quarter of its length."""
        end = start_3 + displacement_3
        side = np.array([-displacement_3[1], displacement_3[0], 0.0])
        self.line(np.stack([start_3, end]), rgb)
        for sign in (-1, 1):
            self.line(np.stack([end, end - 0.25 * displacement_3 + 0.15 * sign * side]), rgb)

    def label(self, text: str) -> None:
        """One line of text at the top left, on a dark band."""
        height = 5 * self.zoom
        self.pixels[: height + 6] //= 3
        scale = height / 22
        cv2.putText(
            self.pixels, text, (4, height), cv2.FONT_HERSHEY_SIMPLEX, scale, INK, 1, cv2.LINE_AA
        )


def sheet(rows: Sequence[tuple[str, Sequence[Pixels]]]) -> Pixels:
    """Rows of equal tiles H W 3 side by side, each behind a dark field with its name, one word a
    line.
    """
    return np.vstack(
        [np.hstack([_name(text, *tiles[0].shape[:2]), *tiles]) for text, tiles in rows]
    )


def _name(text: str, height: int, width: int) -> Pixels:
    """A field half as wide as a tile."""
    field = np.zeros((height, width // 2, 3), dtype=np.uint8)
    for line_i, word in enumerate(text.split()):
        place = (height // 32, (line_i + 1) * height // 9)
        cv2.putText(field, word, place, cv2.FONT_HERSHEY_SIMPLEX, height / 350, INK, 1, cv2.LINE_AA)
    return field


def write_video(pictures: Iterable[Pixels], path: Path, pictures_per_s: int) -> None:
    """H.264 in MP4 of equally sized H W 3 pictures (even H and W); the same pictures give the same
    bytes.
    """
    with av.open(str(path), "w", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream("libx264", rate=Fraction(pictures_per_s))
        stream.pix_fmt = "yuv420p"
        # Without mbtree=0 the same pictures give one of several files.
        stream.options = {"crf": "26", "preset": "veryfast", "threads": "1", "flags": "+bitexact"}
        stream.options |= {"x264-params": "mbtree=0"}
        for picture_i, pixels in enumerate(pictures):
            if picture_i == 0:
                stream.height, stream.width = pixels.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())


def write_gif(shots: Sequence[tuple[Pixels, float]], path: Path) -> None:
    """An endless GIF of pictures, each shown for its seconds."""
    frames = [
        Image.fromarray(pixels).quantize(128, dither=Image.Dither.NONE) for pixels, _ in shots
    ]
    milliseconds = [round(seconds * 1000) for _, seconds in shots]
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=milliseconds, loop=0, optimize=False
    )
