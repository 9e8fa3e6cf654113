"""Films of forecasts beside the truth, from the pictures of some scenes that ``rollouts``
leaves.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from oes.report.names import BASELINE, MODELS, OURS
from oes.report.rows import RowsError
from oes.viz.overlay import INK, Pixels
from oes.viz.video import write_gif, write_video

SHOWN = (OURS, BASELINE)
PICTURES_PER_S, HOLD_S = 5, 2


def forecast_films(rollouts: Path, task: str, folder: Path) -> list[str]:
    """``rollouts-<task>`` as MP4 and GIF, truth and models side by side; gives their paths from
    ``folder``'s parent.

    Raises RowsError naming a picture that one model lacks, or that is not like the others.
    """
    pictures = film_of(read_scenes([rollouts / f"{task}-{model}" / "scenes" for model in SHOWN]))
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"rollouts-{task}{suffix}" for suffix in (".mp4", ".gif")]
    write_video([*pictures, *[pictures[-1]] * (PICTURES_PER_S * HOLD_S)], paths[0], PICTURES_PER_S)
    seconds = [1 / PICTURES_PER_S] * (len(pictures) - 1) + [1 / PICTURES_PER_S + HOLD_S]
    write_gif(list(zip(pictures, seconds, strict=True)), paths[1])
    return [f"{folder.name}/{path.name}" for path in paths]


def read_scenes(folders: Sequence[Path]) -> NDArray[np.uint8]:
    """Tiles by scene, column (the truth, then each folder's forecast) and time: S C T H W 3."""
    names = sorted({path.name for folder in folders for path in folder.glob("*.png")})
    if not names:
        raise RowsError(f"{folders[0]}: holds no picture of a scene")
    rows = [[folder / name for folder in folders] for name in names]
    tiles = {path: _tiles(path) for row in rows for path in row}
    shape = tiles[rows[0][0]].shape
    for path, found in tiles.items():
        if found.shape != shape:
            raise RowsError(
                f"{path}: holds {found.shape[1]} tiles of {found.shape[2]} px, not {shape[1]} of {shape[2]}"
            )
    return np.stack(
        [np.stack([tiles[row[0]][0], *(tiles[path][1] for path in row)]) for row in rows]
    )


def film_of(tiles_SCTHW3: NDArray[np.uint8]) -> list[Pixels]:
    """A picture for each time: a row a scene, under the names of the columns; its sides are even,
    as H.264 asks.
    """
    _, _, num_times, _, side_px, _ = tiles_SCTHW3.shape
    pictures = []
    for T in range(num_times):
        heads = np.hstack(
            [
                _head(text, side_px)
                for text in (f"truth, T = {T}", *(MODELS[model] for model in SHOWN))
            ]
        )
        picture = np.vstack(
            [heads, *(np.hstack(list(scene_CTHW3[:, T])) for scene_CTHW3 in tiles_SCTHW3)]
        )
        height, width = (length // 2 * 2 for length in picture.shape[:2])
        pictures.append(picture[:height, :width])
    return pictures


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
    """The truth and the forecast of one picture: 2 T H W 3."""
    if not path.is_file():
        raise RowsError(f"{path}: missing, though another model has this scene")
    pixels = np.asarray(Image.open(path).convert("RGB"))
    side_px = pixels.shape[0] // 2
    if side_px == 0 or pixels.shape[0] % 2 or pixels.shape[1] % side_px:
        raise RowsError(
            f"{path}: {pixels.shape[1]} x {pixels.shape[0]} px are not two rows of square tiles"
        )
    return pixels.reshape(2, side_px, -1, side_px, 3).swapaxes(1, 2)
