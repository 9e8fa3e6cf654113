"""World-frame shapes drawn on a camera's image."""

from itertools import product

import cv2
import numpy as np

from oes.episode import Camera, Floats, Pixels
from oes.geom.camera import project

Colour = tuple[int, int, int]

# The palette of Okabe and Ito, which colour-blind people can distinguish.
PERCEIVED: Colour = (0, 114, 178)
FORECAST: Colour = (230, 159, 0)
GOAL: Colour = (0, 158, 115)
PUSH: Colour = (213, 94, 0)
INK: Colour = (255, 255, 255)

_CORNERS_83 = np.array(list(product((-0.5, 0.5), repeat=3)))
_EDGES = [(a, b) for a in range(8) for b in range(a) if a ^ b in (1, 2, 4)]


class CameraOverlay:
    """An enlarged camera image ``pixels`` (H W 3) on which world-frame shapes are drawn."""

    def __init__(self, rgb_HW3: Pixels, camera: Camera, zoom: int) -> None:
        self.camera, self.zoom = camera, zoom
        enlarged = rgb_HW3.repeat(zoom, axis=0).repeat(zoom, axis=1)
        self.pixels: Pixels = np.ascontiguousarray(enlarged)

    def line(self, points_P3: Floats, rgb: Colour) -> None:
        """Draw a polyline through world points, unless any of them is behind the camera."""
        uv_P2, depth_P = project(self.camera.K_33, self.camera.world_T_cam_44, points_P3)
        if (depth_P > 0).all():
            # OpenCV keeps coordinates in 32 bits: points far outside the image are clipped.
            corners = np.rint(np.clip(uv_P2 * self.zoom, -1e4, 1e4)).astype(np.int32)
            cv2.polylines(self.pixels, [corners], False, rgb, max(1, self.zoom // 2), cv2.LINE_AA)

    def box(self, center_3: Floats, size_3: Floats, rgb: Colour) -> None:
        """Draw the twelve edges of an axis-aligned box (metres)."""
        corners = center_3 + size_3 * _CORNERS_83
        for a, b in _EDGES:
            self.line(corners[[a, b]], rgb)

    def ring(self, center_3: Floats, radius_m: float, rgb: Colour) -> None:
        """Draw a horizontal circle."""
        angle = np.linspace(0, 2 * np.pi, 33)
        circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        self.line(center_3 + radius_m * circle, rgb)

    def arrow(self, start_3: Floats, displacement_3: Floats, rgb: Colour) -> None:
        """Draw a horizontal arrow with barbs a quarter of its length."""
        end = start_3 + displacement_3
        side = np.array([-displacement_3[1], displacement_3[0], 0.0])
        self.line(np.stack([start_3, end]), rgb)
        for sign in (-1, 1):
            self.line(np.stack([end, end - 0.25 * displacement_3 + 0.15 * sign * side]), rgb)

    def label(self, text: str) -> None:
        """Write one line of text at the top left, on a dark band."""
        height = 5 * self.zoom
        self.pixels[: height + 6] //= 3
        font, place, scale = cv2.FONT_HERSHEY_SIMPLEX, (4, height), height / 22
        cv2.putText(self.pixels, text, place, font, scale, INK, 1, cv2.LINE_AA)
