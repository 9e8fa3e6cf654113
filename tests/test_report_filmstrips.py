"""Films of forecasts beside the recorded motion, from synthetic filmstrips."""

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from oes.report.filmstrips import FPS, HOLD_S, forecast_film, read_scenes
from oes.report.rows import RowsError
from tests.report_inputs import TILE_PX, write_strips


@pytest.fixture
def rollouts(tmp_path: Path) -> Path:
    for model in ("oes", "graph_xyz"):
        write_strips(tmp_path / "rollouts" / f"falling-{model}" / "scenes", num_scenes=4)
    return tmp_path / "rollouts"


def test_films_show_every_time_and_hold_the_last(rollouts: Path, tmp_path: Path) -> None:
    film = forecast_film(rollouts, "falling", tmp_path)
    assert (film.page, film.path) == ("falling", "films/rollouts-falling.mp4")
    with av.open(str(tmp_path / film.path)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert container.streams.video[0].average_rate == FPS
    assert len(frames) == 6 + FPS * HOLD_S
    assert frames[0].shape == (4 * TILE_PX + TILE_PX // 6, 3 * TILE_PX - 1, 3), (
        "75 columns of pixels, made even"
    )
    for T in range(6):
        middle = frames[T][-TILE_PX // 2, TILE_PX // 2 :: TILE_PX, 0].astype(int)
        assert middle == pytest.approx(np.array([40, 140, 140]) + 20 * T, abs=4), T
    with Image.open((tmp_path / film.path).with_suffix(".gif")) as gif:
        assert gif.n_frames == 6 and gif.size == frames[0].shape[1::-1]
        gif.seek(5)
        assert gif.info["duration"] == 1000 * HOLD_S + 1000 / FPS


def test_columns_are_the_truth_and_each_model_in_order(rollouts: Path) -> None:
    path = rollouts / "falling-graph_xyz" / "scenes" / "test2-000002.png"
    pixels = np.array(Image.open(path))
    pixels[TILE_PX:, 3 * TILE_PX : 4 * TILE_PX] = 7
    Image.fromarray(pixels).save(path)
    tiles_SCTHW3 = read_scenes(
        [rollouts / f"falling-{model}" / "scenes" for model in ("oes", "graph_xyz")]
    )
    assert tiles_SCTHW3.shape == (4, 3, 6, TILE_PX, TILE_PX, 3)
    assert (
        tiles_SCTHW3[2, :, 3, 5, 5, 0].tolist() == [100, 200, 7]
        and (tiles_SCTHW3 == 7).sum() == TILE_PX**2 * 3
    )


def test_pictures_that_lack_or_differ_are_named(rollouts: Path, tmp_path: Path) -> None:
    path = rollouts / "falling-graph_xyz" / "scenes" / "test2-000001.png"
    Image.fromarray(np.zeros((40, 120, 3), np.uint8)).save(path)
    with pytest.raises(
        RowsError,
        match=r"falling-graph_xyz/scenes/test2-000001.png: holds 6 tiles of 20 px, not 6 of",
    ):
        forecast_film(rollouts, "falling", tmp_path)
    Image.fromarray(np.zeros((40, 130, 3), np.uint8)).save(path)
    with pytest.raises(
        RowsError, match=r"test2-000001.png: 130 x 40 px are not two rows of square tiles"
    ):
        forecast_film(rollouts, "falling", tmp_path)
    path.unlink()
    with pytest.raises(RowsError, match=r"falling-graph_xyz/scenes/test2-000001.png: missing"):
        forecast_film(rollouts, "falling", tmp_path)
    with pytest.raises(RowsError, match=r"pushing-oes/scenes: holds no image"):
        forecast_film(rollouts, "pushing", tmp_path)
    assert not (tmp_path / "films").exists()
