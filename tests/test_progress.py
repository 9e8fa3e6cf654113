"""Progress lines and the resumable map."""

import logging
from pathlib import Path

import pytest

from oes.progress import progress_bar, resumable_map


def write(text: str, path: Path) -> str | None:
    if text == "refused":
        return text
    path.write_text(text)
    assert path.suffix == ".txt", "writers may choose their format by the suffix"
    return None


def test_progress_without_a_terminal_is_log_lines_with_time_left(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("oes.progress.SECONDS_BETWEEN_LINES", 0.0)
    caplog.set_level(logging.INFO)
    assert list(progress_bar(range(3), total=3, desc="counting", unit="number")) == [0, 1, 2]
    assert "counting: 3 of 3 numbers, 00:00 left" in caplog.text


def test_only_missing_paths_are_made_and_leftovers_are_removed(tmp_path: Path) -> None:
    items = {tmp_path / f"{name}.txt": name for name in ("a", "b", "refused")}
    (tmp_path / "a.txt").write_text("kept")
    (tmp_path / "part-1-b.txt").write_text("half")
    made = resumable_map(write, items, num_workers=2, desc="writing", unit="file")
    assert sorted(map(str, made)) == ["None", "refused"]
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "a.txt": "kept",
        "b.txt": "b",
    }


def test_a_failed_call_leaves_no_partial_file(tmp_path: Path) -> None:
    def fail(_: int, path: Path) -> None:
        path.mkdir()
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        resumable_map(fail, {tmp_path / "x": 1}, num_workers=1, desc="writing", unit="file")
    assert list(tmp_path.iterdir()) == []
