"""The index of a split, one HTML page: images, displacement and contacts of every episode."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from oes.episode import Episode
from oes.episodes.dataset_card import displacement_mm
from oes.episodes.sheet import Table, contact_pairs, data_uri, html_page, write_sheet
from oes.progress import progress_bar
from oes.record.reader import list_episodes, read_frames

MAX_THUMBNAILS, THUMBNAIL_PX, THUMBNAIL_QUALITY = 1500, 64, 60
SHEETS = "sheets"
HEADER = (
    "episode", "images", "meshes", "objects", "max displacement mm", "min displacement mm",
    "objects touched by the rod", "object pairs in contact", "rod RMS mm",
)  # fmt: skip


def write_index(folder: Path, episodes: Sequence[Episode], camera_i: int, num_sheets: int) -> None:
    """Write index.html about the episodes of a split, and sheets/ of the first ``num_sheets``.

    Each row shows images from camera ``camera_i``, as many as keep the page at a few MB. Raises
    EpisodeError for the first episode whose images cannot be read.
    """
    paths = list_episodes(folder)
    (folder / SHEETS).mkdir(exist_ok=True)
    for path in paths[:num_sheets]:
        write_sheet(path, folder / SHEETS / f"{path.name}.html")
    num_images = max(2, MAX_THUMBNAILS // len(paths))
    rows = []
    for i, path in enumerate(progress_bar(paths, total=len(paths), desc="index", unit="episode")):
        name = f"{SHEETS}/{path.name}.html" if i < num_sheets else path.name
        has_images = 2 * i < MAX_THUMBNAILS
        strip = _strip(path, len(episodes[i].steps), camera_i, num_images) if has_images else ""
        rows.append((name, strip, *_cells(episodes[i])))
    summary = (
        f"{len(paths)} episodes; min and max over the objects of an episode. Click a heading to "
        "sort. The page of any episode: python -m oes.episodes.sheet EPISODE"
    )
    title = f"{episodes[0].task}-{episodes[0].split}"  # the folder still has the name of its work
    html = html_page(title, summary, [Table("Episodes", HEADER, rows)], [])
    (folder / "index.html").write_text(html, encoding="utf-8")


def _strip(path: Path, num_states: int, camera_i: int, num_images: int) -> str:
    """Some states of an episode side by side, the first and the last among them."""
    states = np.linspace(0, num_states - 1, min(num_images, num_states)).round().astype(int)
    images = [read_frames(path, int(i), [camera_i]).rgb_VHW3[0] for i in np.unique(states)]
    size = (THUMBNAIL_PX, THUMBNAIL_PX)
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in images]
    return data_uri(np.hstack(small).astype(np.uint8), "jpeg", THUMBNAIL_QUALITY)


def _cells(episode: Episode) -> Sequence[str]:
    moved_mm, pairs = displacement_mm(episode, len(episode.steps) - 1), contact_pairs(episode)
    return (
        ", ".join(body.mesh for body in episode.bodies),
        str(len(episode.bodies)),
        f"{moved_mm.max(initial=0):.0f}",
        f"{moved_mm.min(initial=np.inf):.0f}",
        str(sum(a == 1 for a, _ in pairs)),
        str(sum(a > 1 for a, _ in pairs)),
        f"{episode.rod_rms_m * 1000:.2f}" if episode.has_robot else "",
    )
