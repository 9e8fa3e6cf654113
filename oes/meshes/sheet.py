"""The contact sheet: every mesh of a catalogue, shaded, with its name, category, split and size."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from numpy.typing import NDArray

from oes.meshes.catalogue import TEST, Catalogue, Mesh
from oes.meshes.portrait import portrait

COLUMNS, GAP_PX, HEAD_PX, CAPTION_PX = 8, 16, 84, 54
BAR_M = 0.02
PAPER_RGB = np.array([0.975, 0.972, 0.965])
INK, FAINT, TEST_INK = "#22262b", "#747b83", "#b3401f"
CATEGORY_RGB = {
    "mit_push": (0.50, 0.57, 0.66),
    "camera": (0.40, 0.45, 0.52),
    "mug": (0.80, 0.45, 0.34),
    "bowl": (0.36, 0.61, 0.55),
    "bed": (0.82, 0.67, 0.46),
    "block": (0.57, 0.52, 0.70),
}
OTHER_RGB = (0.66, 0.58, 0.52)
NAME_PT, FULL_LETTERS, MOST_LETTERS = 9.5, 23, 30  # longer names are set smaller, then cut


def write_sheet(catalogue: Catalogue, tile_px: int, path: Path) -> None:
    """Draw the catalogue's meshes, eight a row, and write a PNG (the same bytes for the same
    meshes).
    """
    meshes = list(catalogue.meshes.values())
    cell_px = np.array([tile_px + GAP_PX, tile_px + CAPTION_PX + GAP_PX])
    grid = (max(3, min(COLUMNS, len(meshes))), -(-len(meshes) // COLUMNS))
    width_px, height_px = (cell_px * grid + (GAP_PX, HEAD_PX)).tolist()
    figure = Figure(figsize=(width_px / 100, height_px / 100), dpi=100, facecolor=tuple(PAPER_RGB))
    canvas = figure.add_axes((0, 0, 1, 1), xlim=(0, width_px), ylim=(height_px, 0))
    canvas.axis("off")
    with mpl.rc_context({"font.family": "DejaVu Sans"}):
        canvas.text(
            GAP_PX, 34, f"{len(meshes)} meshes", color=INK, fontsize=15, weight="bold", va="center"
        )
        canvas.text(GAP_PX, 59, _summary(catalogue), color=FAINT, fontsize=9, va="center")
        for i, mesh in enumerate(meshes):
            left_px, top_px = (cell_px * (i % COLUMNS, i // COLUMNS) + (GAP_PX, HEAD_PX)).tolist()
            _tile(canvas, mesh, left_px, top_px, tile_px)
        FigureCanvasAgg(figure).print_png(path, metadata={"Software": None})  # type: ignore[no-untyped-call]


def _summary(catalogue: Catalogue) -> str:
    counts = ", ".join(
        f"{number} {split}" for split, number in sorted(catalogue.counts().items(), reverse=True)
    )
    return f"{counts}. Each tile has its own scale: the bar is {BAR_M * 100:g} cm. Sizes are x, y, z in millimetres."


def _tile(canvas: Axes, mesh: Mesh, left_px: float, top_px: float, tile_px: int) -> None:
    """One mesh's picture with its caption below and a scale bar in the corner."""
    rgb_3 = np.array(CATEGORY_RGB.get(mesh.category, OTHER_RGB))
    image_HW3, px_per_m = portrait(mesh.visual, rgb_3, PAPER_RGB, tile_px)
    extent = (left_px, left_px + tile_px, top_px + tile_px, top_px)
    canvas.imshow(
        _bytes(image_HW3), extent=extent, interpolation="nearest", aspect="auto", zorder=1
    )
    bar_px, base_px = BAR_M * px_per_m, top_px + tile_px - 5
    canvas.plot(
        [left_px, left_px + bar_px],
        [base_px, base_px],
        color=FAINT,
        linewidth=1.6,
        solid_capstyle="butt",
    )
    name_px, size_px = top_px + tile_px + 14, top_px + tile_px + 33
    name = mesh.id[:MOST_LETTERS]
    name_pt = NAME_PT * min(1.0, FULL_LETTERS / len(name))
    canvas.text(left_px, name_px, name, color=INK, fontsize=name_pt, weight="bold", va="center")
    sides = " \u00d7 ".join(f"{side * 1e3:.0f}" for side in mesh.extents_m_3)
    canvas.text(
        left_px,
        size_px,
        f"{mesh.category.replace('_', ' ')}   {sides}",
        color=FAINT,
        fontsize=8,
        va="center",
    )
    is_test = mesh.split == TEST
    box = FancyBboxPatch(
        (left_px + tile_px - 34, name_px - 7),
        32,
        14,
        boxstyle="round,pad=0,rounding_size=5",
        facecolor=TEST_INK if is_test else "#e4e2dc",
        edgecolor="none",
    )
    canvas.add_patch(box)
    ink = "white" if is_test else FAINT
    canvas.text(
        left_px + tile_px - 18,
        name_px + 0.5,
        mesh.split,
        color=ink,
        fontsize=7.5,
        ha="center",
        va="center",
    )


def _bytes(image_HW3: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.asarray(np.round(image_HW3 * 255), np.uint8)
