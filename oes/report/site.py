"""reports/index.html: all pages in one file that needs no network."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from oes.report.aggregates import as_dicts
from oes.report.names import (
    BASELINE,
    CONTACT,
    CONTACT_NOTE,
    LAST,
    OURS,
    SCENARIOS,
    VARIED,
    label,
    views_key,
)
from oes.report.pages import Page
from oes.report.table import Table

TYPES = {".png": "image/png", ".webp": "image/webp", ".mp4": "video/mp4"}


@dataclass(frozen=True)
class Fact:
    """A number and its meaning."""

    value: str
    text: str


def facts(frame: pd.DataFrame) -> list[Fact]:
    """The headline numbers of the frame: ratios, average precision, success of trials."""
    found = []
    for row in as_dicts(frame):
        model, task, mean = label(row["model"]), row["task"].capitalize(), row["mean"]
        match row["block"], row["model"], row["metric"]:
            case "ratio", str(), "translation_mm":
                if (row["against"], row["group"], row["T"]) == (BASELINE, VARIED, LAST):
                    text = f"{task}: translation error of {model} over graph-XYZ, T = {LAST}"
                    found.append(Fact(f"{mean:.2f}", text))
            case "detector", _, "ap_50" if row["group"] == views_key(1):
                found.append(Fact(f"{mean:.2f}", f"{task}: AP at IoU 0.5, novel objects, one view"))
            case "mpc", "oes" | "contact", "success" if row["group"] in ("targets", "obstacle"):
                scenario = SCENARIOS[row["group"]]
                text = f"{model}: success of {row['n']} trials {scenario} ({row['planner']})"
                found.append(Fact(f"{mean:.2f}", text))
    return found


def write_site(
    path: Path, opening: Sequence[str], shown: Sequence[Fact], results: Table, pages: Sequence[Page]
) -> None:
    """Write the page; media are read from ``path``'s folder. Raises FileNotFoundError."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["inside"] = lambda name: _inside(path.parent / name)
    text = environment.get_template("index.html.jinja").render(
        opening=opening, facts=shown, results=results, pages=pages, note=CONTACT_NOTE,
        highlighted={label(OURS), label(CONTACT)},
    )  # fmt: skip
    path.write_text(text, encoding="utf-8")


def _inside(path: Path) -> str:
    """A file as a data URI."""
    return f"data:{TYPES[path.suffix]};base64,{b64encode(path.read_bytes()).decode()}"
