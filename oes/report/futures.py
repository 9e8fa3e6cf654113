"""Imagined futures: how good they are as pictures, whether all sides agree, and forecasts of
changed scenes.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oes.metrics.statistics import bootstrap_mean
from oes.report.names import BASELINE, MODELS, OURS, in_order
from oes.report.rows import Columns, Kind, optional_float, read_columns, select
from oes.report.table import Table, rounded

_ABOUT: dict[str, Kind] = {"episode_i": int, "T": int}
RENDERS: dict[str, Kind] = {
    **_ABOUT,
    "source": str,
    **dict.fromkeys(("psnr_db", "ssim", "objects_psnr_db", "feature_error"), optional_float),
}
CONSISTENCY: dict[str, Kind] = {
    **_ABOUT,
    "source": str,
    **dict.fromkeys(("views_found", "centre_mm", "spread_mm"), optional_float),
}
EDITS: dict[str, Kind] = {
    **_ABOUT,
    "edit": str,
    "model": str,
    "translation_mm": float,
    "rotation_deg": float,
}
FILES = {
    "renders": (RENDERS, "source"),
    "consistency": (CONSISTENCY, "source"),
    "edits": (EDITS, "model"),
}

SOURCES = {
    **MODELS,
    "truth": "true motion",
    "encoded": "encoded from the future itself",
    "photograph": "photographs",
}
KINDS = {
    "none": "as it was",
    "move": "one object moved",
    "resize": "one object resized",
    "remove": "one object taken away",
    "add": "one object more",
    "push": "pushed another way",
}
RENDER_NOTE = (
    "Object features of the first frame (one view), masked, moved as each row says and drawn over the rest of the map, "
    "then decoded for three cameras at T = 1 / 3 / 5 (paper 3.2). Objects: pixels that show an object then or at first "
    "and never the robot, whose features stay where they were. Feature error: norm of the difference from the map "
    "encoded from the future photograph over that map's norm, what is visible within the objects' hulls."
)
CONSISTENCY_NOTE = (
    "Each of three views of an imagined future, encoded alone, and objects detected in it: how many views show an "
    "object, how far its centre is from where it was drawn, and how far apart the views put it. Photographs: the same "
    "from true pictures and true objects, which is what detection alone leaves."
)
EDIT_NOTE = (
    "T = 5, one view, predicted boxes: the first scene is changed alike in Bullet and in what was perceived, then "
    "simulated and forecast. Mean over objects [bootstrap 95% interval over episodes]."
)
LAST = 5


@dataclass(frozen=True)
class Futures:
    """The rows of one task by the name of their file."""

    task: str
    rows: Mapping[str, Columns]


def read_futures(folder: Path, tasks: Sequence[str]) -> list[Futures]:
    """Those of the tasks that were imagined. Raises RowsError."""
    return [
        Futures(
            task,
            {
                name: read_columns([folder / task / f"{name}.csv"], kinds)
                for name, (kinds, _) in FILES.items()
            },
        )
        for task in tasks
        if (folder / task).exists()
    ]


def futures_tables(found: Sequence[Futures], seed: int, notes: tuple[str, ...]) -> list[Table]:
    """``futures``, ``consistency`` and ``counterfactuals``; none where nothing was imagined."""
    if not found:
        return []
    return [
        _means_table(
            "futures",
            "Imagined futures as pictures and features",
            "renders",
            found,
            (RENDER_NOTE, *notes),
        ),
        _means_table(
            "consistency",
            "Imagined futures seen again",
            "consistency",
            found,
            (CONSISTENCY_NOTE, *notes),
        ),
        _edits_table(found, seed, (EDIT_NOTE, *notes)),
    ]


def futures_tree(found: Sequence[Futures]) -> dict[str, Any]:
    """task -> file -> (change ->) model or source -> T -> means."""
    tree: dict[str, Any] = {}
    for each in found:
        edits = each.rows["edits"]
        tree[each.task] = {
            **{name: _tree(each.rows[name], name) for name in ("renders", "consistency")},
            "edits": {
                kind: _tree(select(edits, edit=kind), "edits")
                for kind in KINDS
                if kind in edits["edit"]
            },
        }
    return tree


CAPTIONS = {
    "forecast": "what happened, and what 3D-OES and graph-XYZ imagine, from the first photograph's side",
    "views": "what happened and what 3D-OES imagines, from three sides",
    "prediction": "views that were not seen, predicted from one and from three that were",
    "edits": "scenes as they were and changed: what Bullet does, what 3D-OES imagines",
}


def copy_gallery(found: Sequence[Futures], folder: Path, out: Path) -> dict[str, str]:
    """The pictures of imagined futures in ``out``, from its parent, with their captions."""
    return {
        f"{out.name}/{target.name}": f"{task}: {CAPTIONS[target.name.split('-')[2]]}."
        for task, target in _copied(found, folder, out, "*.png")
    }


def copy_side_films(found: Sequence[Futures], folder: Path, out: Path) -> list[str]:
    """The films of futures from three sides in ``out``, from its parent."""
    return [f"{out.name}/{target.name}" for _, target in _copied(found, folder, out, "*.mp4")]


def _copied(
    found: Sequence[Futures], folder: Path, out: Path, pattern: str
) -> list[tuple[str, Path]]:
    """Files of the galleries, each with its task."""
    out.mkdir(parents=True, exist_ok=True)
    pairs = [
        (each.task, path)
        for each in found
        for path in sorted((folder / each.task / "gallery").glob(pattern))
    ]
    return [
        (task, Path(shutil.copyfile(path, out / f"imagined-{task}-{path.name}")))
        for task, path in pairs
    ]


def _tree(rows: Columns, name: str) -> dict[str, dict[str, dict[str, float]]]:
    """model or source -> T -> mean of every measure."""
    kinds, key = FILES[name]
    measures = [measure for measure in kinds if measure not in (*_ABOUT, "edit", key)]
    return {
        str(word): {
            str(T): _means(select(rows, T=T, **{key: word}), measures) for T in np.unique(rows["T"])
        }
        for word in in_order(np.unique(rows[key]).tolist())
    }


def _means(rows: Columns, measures: Sequence[str]) -> dict[str, float]:
    values = {name: rows[name][~np.isnan(rows[name])] for name in measures}
    return {name: float(x.mean()) if len(x) else float("nan") for name, x in values.items()} | {
        "n": len(rows["T"])
    }


def _means_table(
    name: str, caption: str, file: str, found: Sequence[Futures], notes: tuple[str, ...]
) -> Table:
    """A row per task and source; a cell holds its measure at every T."""
    trees = {each.task: _tree(each.rows[file], file) for each in found}
    at = [(task, word, by_T) for task, tree in trees.items() for word, by_T in tree.items()]
    names = {
        "psnr_db": ("PSNR (dB)", 1),
        "objects_psnr_db": ("PSNR of objects (dB)", 1),
        "ssim": ("SSIM", 3),
        "feature_error": ("feature error", 2),
        "views_found": ("views that show it", 2),
        "centre_mm": ("from where it was drawn (mm)", 1),
        "spread_mm": ("between views (mm)", 1),
    }
    measures = [measure for measure in names if measure in FILES[file][0]]
    return Table(
        name=name,
        caption=caption,
        header=("task", "drawn", *(names[measure][0] for measure in measures), "n"),
        cells=tuple(
            (
                task,
                SOURCES.get(word, word),
                *(
                    " / ".join(f"{values[m]:.{names[m][1]}f}" for values in by_T.values())
                    for m in measures
                ),
                str(next(iter(by_T.values()))["n"]),
            )
            for task, word, by_T in at
        ),
        records=tuple(
            {"task": task, "source": word, "T": T, **rounded(values)}
            for task, word, by_T in at
            for T, values in by_T.items()
        ),
        notes=notes,
    )


def _edits_table(found: Sequence[Futures], seed: int, notes: tuple[str, ...]) -> Table:
    """A row per task and kind of change; translation and rotation of every model."""
    cells, records = [], []
    words = [
        word
        for word in ("static", BASELINE, OURS)
        if any(word in each.rows["edits"]["model"] for each in found)
    ]
    for each in found:
        rows = select(each.rows["edits"], T=LAST)
        for kind in (kind for kind in KINDS if kind in rows["edit"]):
            here = {word: select(rows, edit=kind, model=word) for word in words}
            line = [
                _interval(here[word], name, seed)
                for name in ("translation_mm", "rotation_deg")
                for word in words
            ]
            cells.append((each.task, KINDS[kind], *line, str(len(here[words[0]]["T"]))))
            records += [
                {
                    "task": each.task,
                    "edit": kind,
                    "model": word,
                    **rounded(_means(here[word], ("translation_mm", "rotation_deg"))),
                }
                for word in words
            ]
    header = [
        f"{MODELS[word]}: {unit}"
        for unit in ("translation (mm)", "rotation (deg)")
        for word in words
    ]
    return Table(
        name="counterfactuals",
        caption="Forecasts of changed scenes",
        header=("task", "change", *header, "objects"),
        cells=tuple(cells),
        records=tuple(records),
        notes=notes,
    )


def _interval(rows: Columns, name: str, seed: int) -> str:
    mean, low, high = bootstrap_mean(rows[name], rows["episode_i"], seed)
    return f"{mean:.1f} [{low:.1f}, {high:.1f}]"
