"""The index of a split, one HTML page: images, displacement and contacts of every episode."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from oes.episode import ROBOT, Episode
from oes.episodes.motion import contact_pairs, displacement_mm
from oes.episodes.sheet import data_uri, render_html, write_sheet
from oes.progress import progress_bar
from oes.record.reader import list_episodes, read_frames

MAX_THUMBNAILS, THUMBNAIL_PX, THUMBNAIL_QUALITY = 1500, 64, 60


def write_index(folder: Path, episodes: Sequence[Episode], camera_i: int, num_sheets: int) -> None:
    """Write index.html about the episodes of a split, and sheets/ of the first ``num_sheets``.

    Each row shows images from camera ``camera_i``, as many as keep the page at a few MB. Raises
    EpisodeError for the first episode whose images cannot be read.
    """
    (folder / "sheets").mkdir(exist_ok=True)
    num_images = max(2, MAX_THUMBNAILS // len(episodes))
    rows = []
    bar = progress_bar(list_episodes(folder), total=len(episodes), desc="index", unit="episode")
    for i, (path, episode) in enumerate(zip(bar, episodes, strict=True)):
        sheet = f"sheets/{path.name}.html" if i < num_sheets else ""
        if sheet:
            write_sheet(path, folder / sheet)
        strip = ""
        if 2 * i < MAX_THUMBNAILS:
            strip = _strip(path, len(episode.steps), camera_i, num_images)
        pairs = contact_pairs(episode)
        row = {
            "name": path.name,
            "sheet": sheet,
            "strip": strip,
            "episode": episode,
            "moved_mm_N": displacement_mm(episode, len(episode.steps) - 1).tolist(),
            "rod_contacts": sum(a == ROBOT for a, _ in pairs),
            "object_contacts": sum(a > ROBOT for a, _ in pairs),
        }
        rows.append(row)
    # Not the folder's name, which is a digest until the stage is done.
    title = f"{episodes[0].task}-{episodes[0].split}"
    html = render_html("index.html.jinja", title=title, rows=rows)
    (folder / "index.html").write_text(html, encoding="utf-8")


def _strip(path: Path, num_states: int, camera_i: int, num_images: int) -> str:
    """Some states of an episode side by side, the first and the last among them."""
    states = np.linspace(0, num_states - 1, min(num_images, num_states)).round().astype(int)
    images = [read_frames(path, int(i), [camera_i]).rgb_VHW3[0] for i in np.unique(states)]
    size = (THUMBNAIL_PX, THUMBNAIL_PX)
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images]
    return data_uri(np.hstack(small).astype(np.uint8), "jpeg", THUMBNAIL_QUALITY)
