"""Contact sheet of a mesh catalogue: every mesh with its name, category, split and size."""

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from oes.episode import SEG_FIRST_OBJECT, SEG_NOTHING, Camera, Floats
from oes.geom.camera import intrinsics, look_at
from oes.geom.se3 import rigid, rotation_z
from oes.meshes.catalogue import Catalogue, Mesh
from oes.render.renderer import Renderer
from oes.render.scene import RenderMesh

TILES_PER_ROW, GAP_PX, HEAD_PX, CAPTION_PX = 8, 16, 84, 54
FOV_DEG, SUPERSAMPLING, MARGIN = 12.0, 3, 1.08  # a narrow field of view looks orthographic
VIEW_3 = np.array([-0.46, -0.73, 0.50])  # direction of the camera, on the side of the light
BAR_M = 0.02
PAPER_RGB, TEXT, FAINT, TEST_FACE, TRAIN_FACE = (
    "#f9f8f6",
    "#22262b",
    "#747b83",
    "#b3401f",
    "#e4e2dc",
)
CATEGORY_RGB = {
    "mit_push": (0.50, 0.57, 0.66),
    "camera": (0.40, 0.45, 0.52),
    "mug": (0.80, 0.45, 0.34),
    "bowl": (0.36, 0.61, 0.55),
    "bed": (0.82, 0.67, 0.46),
    "block": (0.57, 0.52, 0.70),
}
OTHER_RGB = (0.66, 0.58, 0.52)
NAME_PT, FULL_LETTERS, MAX_LETTERS = 9.5, 23, 30  # longer names are set smaller, then cut


def write_contact_sheet(catalogue: Catalogue, tile_px: int, path: Path) -> None:
    """Write a PNG with eight meshes a row; deterministic."""
    meshes = list(catalogue.meshes.values())
    cell_px = np.array([tile_px + GAP_PX, tile_px + CAPTION_PX + GAP_PX])
    grid = (max(3, min(TILES_PER_ROW, len(meshes))), -(-len(meshes) // TILES_PER_ROW))
    width_px, height_px = (cell_px * grid + (GAP_PX, HEAD_PX)).tolist()
    figure = Figure(figsize=(width_px / 100, height_px / 100), dpi=100, facecolor=PAPER_RGB)
    canvas = figure.add_axes((0, 0, 1, 1), xlim=(0, width_px), ylim=(height_px, 0))
    canvas.axis("off")
    counts = ", ".join(f"{n} {split}" for split, n in sorted(catalogue.counts().items())[::-1])
    note = f"Each tile has its own scale: the bar is {BAR_M * 100:g} cm. Sizes: x, y, z in mm."
    with mpl.rc_context({"font.family": "DejaVu Sans"}):
        _text(canvas, GAP_PX, 34, f"{len(meshes)} meshes", TEXT, 15, weight="bold")
        _text(canvas, GAP_PX, 59, f"{counts}. {note}", FAINT, 9)
        for i, mesh in enumerate(meshes):
            left_px, top_px = (
                cell_px * (i % TILES_PER_ROW, i // TILES_PER_ROW) + (GAP_PX, HEAD_PX)
            ).tolist()
            _tile(canvas, mesh, left_px, top_px, tile_px)
        FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})


def _tile(canvas: Axes, mesh: Mesh, left_px: float, top_px: float, tile_px: int) -> None:
    """A mesh with a scale bar; below it its name and split, its category and size."""
    rgba_HW4, px_per_m = _image(mesh, tile_px)
    right_px, bottom_px = left_px + tile_px, top_px + tile_px
    extent = (left_px, right_px, bottom_px, top_px)
    canvas.imshow(rgba_HW4, extent=extent, interpolation="nearest", aspect="auto", zorder=1)
    bar = [left_px, left_px + BAR_M * px_per_m], [bottom_px - 5] * 2
    canvas.plot(*bar, color=FAINT, linewidth=1.6, solid_capstyle="butt")
    name, name_px = mesh.id[:MAX_LETTERS], bottom_px + 14
    name_pt = NAME_PT * min(1.0, FULL_LETTERS / len(name))
    _text(canvas, left_px, name_px, name, TEXT, name_pt, weight="bold")
    sides = " \u00d7 ".join(f"{side * 1e3:.0f}" for side in mesh.extents_m_3)
    category = mesh.category.replace("_", " ")
    _text(canvas, left_px, bottom_px + 33, f"{category}   {sides}", FAINT, 8)
    is_test = mesh.split == "test"
    face, ink = (TEST_FACE, "white") if is_test else (TRAIN_FACE, FAINT)
    box = {"boxstyle": "round,pad=0.3", "facecolor": face, "edgecolor": "none"}
    _text(canvas, right_px - 18, name_px, mesh.split, ink, 7.5, ha="center", bbox=box)


def _text(
    canvas: Axes, x: float, y: float, text: str, color: str, size_pt: float, **style: Any
) -> None:
    canvas.text(x, y, text, color=color, fontsize=size_pt, va="center", **style)


def _image(mesh: Mesh, size_px: int) -> tuple[Floats, float]:
    """The mesh in the colour of its category: RGBA (HW4, 0..1), and pixels per metre."""
    points_P3 = mesh.visual.vertices
    radius_m = MARGIN * float(np.linalg.norm(points_P3, axis=1).max())
    distance_m = radius_m / np.sin(np.radians(FOV_DEG / 2))
    full_px = size_px * SUPERSAMPLING
    eye_3 = distance_m * VIEW_3 / np.linalg.norm(VIEW_3)
    K_33 = intrinsics(FOV_DEG, full_px, full_px)
    camera = Camera("sheet", K_33, look_at(eye_3, np.zeros(3)), full_px, full_px)
    rgb_3 = np.array(CATEGORY_RGB.get(mesh.category, OTHER_RGB))
    vertices, faces = points_P3.astype(np.float32), mesh.visual.faces.astype(np.int32)
    drawn = RenderMesh(vertices, faces, SEG_FIRST_OBJECT, 0, rgb_3, None)
    # Fronts (+y) face the camera after half a turn.
    pose_44 = rigid(rotation_z(np.pi), np.zeros(3))
    frames = Renderer([drawn]).render(pose_44[None], [camera])
    alpha_HW1 = (frames.seg_VHW[0] != SEG_NOTHING)[..., None].astype(float)
    rgba_HW4 = np.concatenate([frames.rgb_VHW3[0] / 255 * alpha_HW1, alpha_HW1], axis=2)
    # Averages of colours weighted by alpha, so that edges do not mix with the sky.
    shape = (size_px, SUPERSAMPLING, size_px, SUPERSAMPLING, 4)
    rgba_HW4 = rgba_HW4.reshape(shape).mean(axis=(1, 3))
    rgba_HW4[..., :3] /= np.maximum(rgba_HW4[..., 3:], 1e-9)
    return np.clip(rgba_HW4, 0, 1), K_33[0, 0] / SUPERSAMPLING / distance_m
