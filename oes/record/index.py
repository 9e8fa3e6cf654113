"""An index of a split, one HTML page: a strip of pictures per episode, displacement, contacts,
objects; sortable.
"""

from html import escape
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from oes.episode import Episode
from oes.record.charts import MM, contact_pairs, displacement_mm
from oes.record.page import INDEX_SCRIPT, page
from oes.record.pictures import jpeg_uri
from oes.record.reader import list_episodes, read_episode, read_frames
from oes.record.sheet import episode_sheet

MAX_THUMBNAILS = 1500
THUMBNAIL_PX = 64
THUMBNAIL_QUALITY = 60
SHEETS = "sheets"
INDEX_COLUMNS = (
    "episode",
    "states",
    "objects",
    "n",
    "most mm",
    "least mm",
    "pushed",
    "object contacts",
    "rod RMS mm",
)
NUMBERS_FROM = 3


def write_index(folder: Path, camera_i: int, num_sheets: int) -> None:
    """Write ``folder``/index.html about its episodes, and contact sheets of the first
    ``num_sheets`` under sheets/.

    Pictures come from camera ``camera_i``: as many states of each episode as keep the page at a few
    MB. Raises EpisodeError for the first episode that cannot be read.
    """
    paths = list_episodes(folder)
    (folder / SHEETS).mkdir(exist_ok=True)
    for path in paths[:num_sheets]:
        (folder / SHEETS / f"{path.name}.html").write_text(episode_sheet(path), encoding="utf-8")
    num_pictures = max(2, MAX_THUMBNAILS // max(1, len(paths)))
    rows = []
    for position, path in enumerate(tqdm(paths, desc="index", unit="episode", disable=None)):
        episode = read_episode(path)
        strip = (
            _strip(path, len(episode.steps), camera_i, num_pictures)
            if 2 * position < MAX_THUMBNAILS
            else ""
        )
        rows.append(_row(path.name, episode, strip, has_sheet=position < num_sheets))
    head = "".join(f'<th class="{_align(i)}">{name}</th>' for i, name in enumerate(INDEX_COLUMNS))
    body = f"""
<header><h1>{escape(folder.name)}</h1>
<p>{len(paths)} episodes. n: objects; most, least: displacement of the object that moved most and least; pushed:
objects that the rod touched; object contacts: pairs of objects that touched. Click a heading to sort.
A contact sheet of any episode: <code>python -m oes.record.sheet EPISODE</code></p></header>
<table class="index"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>"""
    (folder / "index.html").write_text(page(folder.name, body, INDEX_SCRIPT), encoding="utf-8")


def _strip(path: Path, num_steps: int, camera_i: int, num_pictures: int) -> str:
    """Some states of an episode, first and last among them, side by side."""
    step_is = np.unique(
        np.linspace(0, num_steps - 1, min(num_pictures, num_steps)).round().astype(int)
    )
    images = [read_frames(path, int(step_i), [camera_i]).rgb_VHW3[0] for step_i in step_is]
    small = [
        cv2.resize(image, (THUMBNAIL_PX, THUMBNAIL_PX), interpolation=cv2.INTER_AREA)
        for image in images
    ]
    uri = jpeg_uri(np.hstack(small).astype(np.uint8), THUMBNAIL_QUALITY)
    return f'<img width="{THUMBNAIL_PX * len(small)}" height="{THUMBNAIL_PX}" loading="lazy" src="{uri}" alt="">'


def _row(name: str, episode: Episode, strip: str, has_sheet: bool) -> str:
    moved_mm = displacement_mm(episode)[-1]
    pairs = contact_pairs(episode)
    cells = [
        f'<a href="{SHEETS}/{name}.html">{name}</a>' if has_sheet else name,
        strip,
        escape(", ".join(body.mesh for body in episode.bodies)),
        str(len(episode.bodies)),
        f"{moved_mm.max(initial=0):.0f}",
        f"{moved_mm.min(initial=np.inf):.0f}",
        str(sum(a == 1 for a, _ in pairs)),
        str(sum(a > 1 for a, _ in pairs)),
        f"{episode.rod_rms_m * MM:.2f}" if episode.has_robot else "",
    ]
    return (
        "<tr>"
        + "".join(f'<td class="{_align(i)}">{cell}</td>' for i, cell in enumerate(cells))
        + "</tr>"
    )


def _align(column: int) -> str:
    """The class of a column's cells."""
    return "number" if column >= NUMBERS_FROM else INDEX_COLUMNS[column]
