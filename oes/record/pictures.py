"""Small pictures of recorded views as data URIs: mosaics of all cameras, strips of one, boxes as
SVG paths.
"""

from base64 import b64encode

import cv2
import numpy as np
from numpy.typing import NDArray

from oes.episode import SEG_FIRST_OBJECT, SEG_NOTHING, SEG_ROBOT, SEG_TABLE, Camera, Floats
from oes.geom.camera import project

Pixels = NDArray[np.uint8]

OBJECT_COLORS = ("#e4572e", "#2878b5", "#5b9a3c", "#d9a400", "#8e5ea2", "#3aa6a0", "#b0416a")
SEG_COLORS = {SEG_NOTHING: "#ffffff", SEG_TABLE: "#d8d2c8", SEG_ROBOT: "#6b6b6b"}
NUM_COLUMNS = 9
BOX_EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if (a ^ b) in (1, 2, 4)]


def object_color(object_i: int) -> str:
    """The colour of an object in every picture and chart."""
    return OBJECT_COLORS[object_i % len(OBJECT_COLORS)]


def mosaic(images_VHW3: Pixels) -> Pixels:
    """Views side by side, nine to a row, the last row first: the highest cameras stand on top."""
    num_views, height, width, _ = images_VHW3.shape
    num_rows = -(-num_views // NUM_COLUMNS)
    padded = np.full((num_rows * NUM_COLUMNS, height, width, 3), 255, np.uint8)
    padded[:num_views] = images_VHW3
    rows = padded.reshape(num_rows, NUM_COLUMNS, height, width, 3)[::-1]
    return np.ascontiguousarray(rows.transpose(0, 2, 1, 3, 4)).reshape(
        num_rows * height, NUM_COLUMNS * width, 3
    )


def place(view_i: int, num_views: int, size_px: tuple[int, int]) -> tuple[int, int]:
    """The left upper corner (x, y) in pixels of one view in the mosaic; ``size_px`` is width and
    height of a view.
    """
    num_rows = -(-num_views // NUM_COLUMNS)
    row, column = divmod(view_i, NUM_COLUMNS)
    return column * size_px[0], (num_rows - 1 - row) * size_px[1]


def depth_picture(depth_m_VHW: NDArray[np.float32], near_m: float, far_m: float) -> Pixels:
    """Depth as colour, from near (yellow) to far (dark); white where nothing returned."""
    share = np.clip((depth_m_VHW - near_m) / max(far_m - near_m, 1e-6), 0, 1)
    gray = (255 * (1 - share)).astype(np.uint8)
    colored = cv2.applyColorMap(gray.reshape(-1, gray.shape[-1]), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    return np.where(depth_m_VHW[..., None] > 0, colored.reshape(*gray.shape, 3), 255).astype(
        np.uint8
    )


def seg_picture(seg_VHW: Pixels) -> Pixels:
    """Segmentation ids as flat colours."""
    palette = np.zeros((256, 3), np.uint8)
    colors = SEG_COLORS | {
        i: object_color(i - SEG_FIRST_OBJECT) for i in range(SEG_FIRST_OBJECT, 256)
    }
    for seg_id, color in colors.items():
        palette[seg_id] = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    return palette[seg_VHW]


def jpeg_uri(image_HW3: Pixels, quality: int) -> str:
    """A JPEG as a data URI."""
    _, data = cv2.imencode(".jpg", image_HW3[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return f"data:image/jpeg;base64,{b64encode(data.tobytes()).decode()}"


def png_uri(image_HW3: Pixels) -> str:
    """A PNG as a data URI; smaller than JPEG for few flat colours."""
    _, data = cv2.imencode(".png", image_HW3[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return f"data:image/png;base64,{b64encode(data.tobytes()).decode()}"


def box_path(camera: Camera, corner_xy: tuple[int, int], center_3: Floats, size_3: Floats) -> str:
    """The edges of a world-axes box as seen by a camera, as an SVG path in mosaic pixels; empty if
    behind it.
    """
    signs_83 = np.array([[(i >> axis & 1) - 0.5 for axis in range(3)] for i in range(8)])
    uv_82, depth_8 = project(camera.K_33, camera.world_T_cam_44, center_3 + signs_83 * size_3)
    if depth_8.min() <= 0:
        return ""
    x, y = (np.clip(uv_82, 0, [camera.width_px, camera.height_px]) + corner_xy).T
    return "".join(f"M{x[a]:.0f} {y[a]:.0f}L{x[b]:.0f} {y[b]:.0f}" for a, b in BOX_EDGES)
