"""Films of forecasts beside the recorded motion, from the filmstrips that ``rollouts`` writes."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from oes.episode import Pixels
from oes.report.figures import Media
from oes.report.names import BASELINE, OURS
from oes.report.rows import RowsError
from oes.schema import MODEL_LABELS
from oes.viz.overlay import INK
from oes.viz.video import write_gif, write_video

SHOWN = (OURS, BASELINE)
FPS, HOLD_S = 5, 2
GIF_OF = "falling"


def forecast_film(rollouts: Path, task: str, out: Path) -> Media:
    """``films/rollouts-<task>.mp4``: recorded motion and forecasts side by side. Of ``GIF_OF`` also
    as a GIF, for README.md.

    Raises RowsError naming an image that one model lacks, or of another shape than the others.
    """
    images = film_of(read_scenes([rollouts / f"{task}-{model}" / "scenes" for model in SHOWN]))
    (out / "films").mkdir(parents=True, exist_ok=True)
    name = f"films/rollouts-{task}"
    write_video([*images, *[images[-1]] * (FPS * HOLD_S)], out / f"{name}.mp4", FPS)
    if task == GIF_OF:
        seconds = [1 / FPS] * (len(images) - 1) + [1 / FPS + HOLD_S]
        write_gif(list(zip(images, seconds, strict=True)), out / f"{name}.gif")
    models = " and ".join(MODEL_LABELS[model] for model in SHOWN)
    caption = f"{task.capitalize()}: recorded motion, and forecasts of {models}, on novel objects."
    return Media(task, f"{name}.mp4", caption)


def read_scenes(folders: Sequence[Path]) -> NDArray[np.uint8]:
    """Tiles by scene, column (recorded, then each folder's forecast) and state: S C T H W 3."""
    names = sorted({path.name for folder in folders for path in folder.glob("*.png")})
    if not names:
        raise RowsError(f"{folders[0]}: holds no image of a scene")
    rows = [[folder / name for folder in folders] for name in names]
    tiles = {path: _tiles(path) for row in rows for path in row}
    shape = tiles[rows[0][0]].shape
    for path, found in tiles.items():
        if found.shape != shape:
            raise RowsError(
                f"{path}: holds {found.shape[1]} tiles of {found.shape[2]} px, "
                f"not {shape[1]} of {shape[2]}"
            )
    return np.stack(
        [np.stack([tiles[row[0]][0], *(tiles[path][1] for path in row)]) for row in rows]
    )


def film_of(tiles_SCTHW3: NDArray[np.uint8]) -> list[Pixels]:
    """An image per state: a row per scene below the names of the columns; even sides for H.264."""
    _, _, num_times, _, side_px, _ = tiles_SCTHW3.shape
    images = []
    for T in range(num_times):
        heads = np.hstack(
            [
                _head(text, side_px)
                for text in (f"truth, T = {T}", *(MODEL_LABELS[model] for model in SHOWN))
            ]
        )
        image = np.vstack(
            [heads, *(np.hstack(list(scene_CTHW3[:, T])) for scene_CTHW3 in tiles_SCTHW3)]
        )
        height, width = (length // 2 * 2 for length in image.shape[:2])
        images.append(image[:height, :width])
    return images


def _head(text: str, side_px: int) -> Pixels:
    """A dark band with the name of a column, as wide as a tile."""
    band = np.zeros((side_px // 6, side_px, 3), dtype=np.uint8)
    cv2.putText(
        band,
        text,
        (side_px // 24, side_px // 8),
        cv2.FONT_HERSHEY_SIMPLEX,
        side_px / 320,
        INK,
        1,
        cv2.LINE_AA,
    )
    return band


def _tiles(path: Path) -> NDArray[np.uint8]:
    """Recorded and forecast tiles of one filmstrip: 2 T H W 3."""
    if not path.is_file():
        raise RowsError(f"{path}: missing, though another model has this scene")
    pixels = np.asarray(Image.open(path).convert("RGB"))
    side_px = pixels.shape[0] // 2
    if side_px == 0 or pixels.shape[0] % 2 or pixels.shape[1] % side_px:
        raise RowsError(
            f"{path}: {pixels.shape[1]} x {pixels.shape[0]} px are not two rows of square tiles"
        )
    return pixels.reshape(2, side_px, -1, side_px, 3).swapaxes(1, 2)
