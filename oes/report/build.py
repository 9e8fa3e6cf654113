"""Everything in reports/, from the raw rows of all stages."""

import shutil
from collections.abc import Mapping
from pathlib import Path

from oes.report.bundle import copy_films, copy_models
from oes.report.card import data_table
from oes.report.curves import write_curves
from oes.report.figures import write_figures
from oes.report.findings import Chapter, Findings, Inputs, Tables, read_findings
from oes.report.forecast import LAST
from oes.report.futures import copy_gallery, copy_side_films, futures_tables, futures_tree
from oes.report.metrics import study_tree, trials_tree, write_json
from oes.report.names import OURS, SCENARIOS
from oes.report.page import headline, write_page
from oes.report.perception import detector_table, view_table, views_key
from oes.report.site import Fact, write_site
from oes.report.strips import forecast_films
from oes.report.study import VARIED, forecast_tables
from oes.report.surfaces import surface_tables, surface_tree
from oes.report.table import Table, write_table
from oes.report.trials import trials_table
from oes.report.video import copy_forecasts, video_table

SHEET = "contact_sheet.png"


def build(cfg: Tables, inputs: Inputs, seeds: Mapping[str, int], out: Path) -> None:
    """Write every table, figure, film, the weights, metrics.json and both pages into ``out``.

    Raises RowsError for rows that cannot be read, FileNotFoundError for a stage's file that is not
    there.
    """
    found = read_findings(cfg, inputs, seeds)
    out.mkdir(parents=True, exist_ok=True)
    tables = _tables(found, cfg)
    for table in tables:
        write_table(table, out)
    figures, films = _figures(found, inputs, out), _films(found, cfg, inputs, out)
    copy_models(inputs.perception, inputs.dynamics, out / "models")
    write_json(_tree(found, cfg), out / "metrics.json")
    opening = [
        text
        for each in found.chapters.values()
        for text in (headline(each.found, VARIED, LAST), each.line)
    ]
    write_page(out / "README.md", opening, tables, figures, films)
    write_site(
        out / "index.html", [found.line], facts(found), tables, (figures, films), found.machine
    )


def facts(found: Findings) -> list[Fact]:
    """The numbers that the study is known by."""
    numbers = [
        Fact(
            f"{ratio[0]:.2f}",
            f"{task}: error of 3D-OES over that of graph-XYZ, T = {LAST}, one view",
        )
        for task, chapter in found.chapters.items()
        if (ratio := chapter.found.ratios.get((VARIED, "translation_mm", LAST)))
    ]
    numbers += [
        Fact(
            f"{chapter.detector[views_key(1)]['ap_50']:.2f}",
            f"{task}: AP at IoU 0.5 of novel objects, one view",
        )
        for task, chapter in found.chapters.items()
    ]
    return numbers + [
        Fact(
            f"{outcome.success:.2f}",
            f"of {outcome.trials} trials {SCENARIOS.get(name, name)} succeed ({outcome.planner})",
        )
        for name, outcomes in found.control.items()
        for outcome in outcomes
        if outcome.model == OURS
    ]


def _tables(found: Findings, cfg: Tables) -> list[Table]:
    line = found.line
    return [
        *(
            table
            for chapter in found.chapters.values()
            for table in forecast_tables(chapter.found, [chapter.line])
        ),
        *surface_tables(found.chapters, cfg.seed, (line,)),
        *(
            trials_table(each, _table3(name, cfg), name, (line,))
            for name, each in found.control.items()
        ),
        *(_detector_table(chapter) for chapter in found.chapters.values()),
        view_table(found.views, (line,)),
        *([video_table(found.video, (line,))] if found.video else []),
        *futures_tables(found.futures, cfg.seed, (line,)),
        data_table(found.cards, (line,)),
    ]


def _figures(found: Findings, inputs: Inputs, out: Path) -> dict[str, str]:
    """All pictures, with their captions."""
    shutil.copyfile(inputs.meshes / SHEET, out / SHEET)
    figures, folder = {SHEET: "The meshes."}, out / "figures"
    for chapter in found.chapters.values():
        figures |= write_figures(chapter.found, chapter.card.displacement_mm, folder)
    detections = {task: chapter.detections for task, chapter in found.chapters.items()}
    figures |= write_curves(inputs.perception, inputs.dynamics, detections, folder)
    return (
        figures
        | copy_forecasts(inputs.dynamics, found.video, folder)
        | copy_gallery(found.futures, inputs.futures, folder)
    )


def _films(found: Findings, cfg: Tables, inputs: Inputs, out: Path) -> dict[str, list[str]]:
    """All films, by what they show."""
    folder = out / "films"
    return {
        "Forecasts": [
            name
            for task in found.chapters
            for name in forecast_films(inputs.rollouts, task, folder)
        ],
        "Imagined from three sides": copy_side_films(found.futures, inputs.futures, folder),
        **{
            f"Trials {SCENARIOS.get(name, name)}": copy_films(
                inputs.trials, found.trials, name, OURS, folder
            )
            for name in cfg.scenarios
        },
    }


def _tree(found: Findings, cfg: Tables) -> dict[str, object]:
    return {
        "profile": cfg.profile,
        "machine": found.machine,
        **{
            key: value
            for chapter in found.chapters.values()
            for key, value in _chapter_tree(chapter).items()
        },
        "mpc": {scenario: trials_tree(each) for scenario, each in found.control.items()},
        **({"video": found.video} if found.video else {}),
        **({"futures": futures_tree(found.futures)} if found.futures else {}),
        **surface_tree(found.chapters, cfg.seed),
        "view_prediction": {**found.views[views_key(1)], **found.views},
    }


def _table3(scenario: str, cfg: Tables) -> str:
    """Table 3 of the paper is the first scenario's."""
    return "table3" if scenario == cfg.scenarios[0] else f"table3-{scenario.replace('_', '-')}"


def _detector_table(chapter: Chapter) -> Table:
    study = chapter.found.study
    caption = f"Detection of novel objects in 3D, {study.task}"
    return detector_table(f"detector{study.suffix}", caption, chapter.detector, (chapter.line,))


def _chapter_tree(chapter: Chapter) -> dict[str, object]:
    study = chapter.found.study
    about = {study.key("detector"): chapter.detector, study.key("capture"): chapter.card.metrics}
    return study_tree(chapter.found) | about
