"""Everything in reports/, from the raw rows of all stages."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from oes.report.aggregates import aggregate
from oes.report.figures import Media, write_figures
from oes.report.filmstrips import forecast_film
from oes.report.inputs import Inputs, RawData, TablesConfig, learning_logs, read_inputs
from oes.report.media import copy_films, copy_images, copy_models
from oes.report.metrics import metrics_tree, plain, summary, write_json, write_plots
from oes.report.pages import fill_pages, write_pages
from oes.report.provenance import describe_machine, provenance
from oes.report.readme import results_block
from oes.report.site import facts, write_site
from oes.report.table import write_group
from oes.report.tables import all_groups, results_table


def build(cfg: TablesConfig, inputs: Inputs, seeds: Mapping[str, int], out: Path) -> None:
    """Write all tables, figures, films, pages, weights and metrics to ``out``.

    Raises RowsError for rows that cannot be read, FileNotFoundError for a missing file.
    """
    raw = read_inputs(cfg, inputs)
    frame = aggregate(raw, cfg.scenarios, cfg.seed)
    logs = learning_logs(inputs.perception, inputs.dynamics, cfg.tasks)
    out.mkdir(parents=True, exist_ok=True)
    media = [
        *write_figures(frame, raw, logs, out),
        *copy_images(inputs, cfg.tasks, out),
        *(forecast_film(inputs.rollouts, task, out) for task in cfg.tasks),
        *copy_films(inputs, raw.trials, cfg, out),
    ]
    copy_models(inputs.perception, inputs.dynamics, out / "models")
    write_plots(frame, logs, out / "plots")
    machine = describe_machine()
    tree = plain({"profile": cfg.profile, "machine": machine, **metrics_tree(frame)})
    opening = [provenance(cfg.profile, _episodes(raw), seeds, machine)]
    write_rendered(frame, tree, media, opening, out)


def write_rendered(
    frame: pd.DataFrame,
    tree: dict[str, Any],
    media: Sequence[Media],
    opening: Sequence[str],
    out: Path,
) -> None:
    """Tables, pages and metrics from the tidy frame and the tree of metrics.json."""
    groups = all_groups(frame)
    (out / "tables").mkdir(parents=True, exist_ok=True)
    for group in groups.values():
        write_group(group, out / "tables")
    write_json(tree, out / "metrics.json")
    write_json(summary(tree), out / "summary.json")
    pages = fill_pages(groups, media)
    write_pages(pages, opening, results_block(tree), out)
    write_site(out / "index.html", opening, facts(frame), results_table(tree), pages)


def _episodes(raw: RawData) -> dict[str, int]:
    """Number of training episodes, and of evaluated episodes of each test split, by task."""
    counts = {}
    for task, errors in raw.errors.items():
        counts[f"{task} train"] = raw.cards[task, "train"].episodes
        for split, rows in errors.groupby("split"):
            counts[f"{task} {split}"] = rows["episode_i"].nunique()
    return counts
