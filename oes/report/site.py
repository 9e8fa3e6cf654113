"""reports/index.html: the study on one page that holds all of its pictures and films and needs no
network.
"""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from oes.report.names import MODELS, OURS
from oes.report.table import Table

TEMPLATE = "index.html.jinja"
TYPES = {
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".mp4": "video/mp4",
    ".json": "application/json",
}


@dataclass(frozen=True)
class Chapter:
    """A section of the page: its text, and how the names of its tables, pictures and films
    begin.
    """

    title: str
    text: str
    tables: tuple[str, ...]
    figures: tuple[str, ...]
    films: tuple[str, ...]


CHAPTERS = (
    Chapter(
        "Forecasts",
        "How far off is the imagined place of each object after T steps? Every model sees the same first photograph.",
        ("table1", "table2", "by-objects", "by-views", "contact-ratios", "ablations"),
        ("error-over-time", "by-objects", "by-views"),
        ("rollouts",),
    ),
    Chapter(
        "Certainty",
        "Contact draws surfaces, masses and frictions as they might be: how far its futures differ tells how sure it "
        "is. Do forecast objects stick in one another, or move though nothing touches them?",
        ("certainty", "sense"),
        (),
        (),
    ),
    Chapter(
        "Imagination",
        "Objects' features are moved to where the forecast puts them and decoded for any camera. The orange line is "
        "the rod; the robot's own features stay as first seen. Then: what if the scene had been another?",
        ("futures", "consistency", "counterfactuals"),
        ("imagined",),
        ("imagined",),
    ),
    Chapter(
        "Control",
        "The robot plans pushes in imagination, carries one out, looks again. Films show what it sees, what it plans "
        "and where it expects the object; the last ones of successes and of failures.",
        ("table3",),
        (),
        ("targets", "obstacle"),
    ),
    Chapter(
        "Perception",
        "What is seen of novel objects, and what the baselines that forecast pictures have learned.",
        ("detector", "view-prediction", "video"),
        ("reliability", "forecasts"),
        (),
    ),
    Chapter(
        "Data and training",
        "The objects, how far they move in the training episodes, and how the losses fell.",
        ("data",),
        ("contact_sheet", "displacement", "learning"),
        (),
    ),
)


@dataclass(frozen=True)
class Fact:
    """A number and what it says."""

    value: str
    text: str


def write_site(
    path: Path,
    opening: Sequence[str],
    facts: Sequence[Fact],
    tables: Sequence[Table],
    pictures: tuple[Mapping[str, str], Mapping[str, Sequence[str]]],
    machine: str,
) -> None:
    """Write the page; ``pictures``: captions by path and films by heading, all relative to the
    page's folder.

    Raises FileNotFoundError for a picture or film that is not there.
    """
    figures, films = pictures
    names = [name for group in films.values() for name in group if name.endswith(".mp4")]
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    sections = [_section(chapter, tables, figures, names, path.parent) for chapter in CHAPTERS]
    page = environment.get_template(TEMPLATE).render(
        opening=opening,
        facts=facts,
        sections=[
            section
            for section in sections
            if section["tables"] or section["figures"] or section["films"]
        ],
        ours=MODELS[OURS],
        machine=machine,
        metrics=_inside(path.parent / "metrics.json"),
    )
    path.write_text(page, encoding="utf-8")


def _section(
    chapter: Chapter,
    tables: Sequence[Table],
    figures: Mapping[str, str],
    films: Sequence[str],
    folder: Path,
) -> dict[str, object]:
    return {
        "title": chapter.title,
        "anchor": chapter.title.split()[0].lower(),
        "text": chapter.text,
        "tables": [table for table in tables if table.name.startswith(chapter.tables or (" ",))],
        "figures": [
            {
                "source": _inside(_sharpest(folder / name)),
                "caption": caption,
                "wide": _is_wide(name),
            }
            for name, caption in figures.items()
            if _is_of(name, chapter.figures) and name.endswith(".png")
        ],
        "films": [
            {
                "source": _inside(folder / name),
                "caption": Path(name).stem.replace("_", " ").replace("-", " "),
            }
            for name in films
            if _is_of(name, chapter.films)
        ],
    }


def _is_of(name: str, starts: Sequence[str]) -> bool:
    return Path(name).name.startswith(tuple(starts) or (" ",))


def _is_wide(name: str) -> bool:
    return not Path(name).name.startswith(("displacement", "forecasts"))


def _sharpest(path: Path) -> Path:
    """The same figure as SVG, where there is one."""
    return path.with_suffix(".svg") if path.with_suffix(".svg").exists() else path


def _inside(path: Path) -> str:
    """A file as a data URI."""
    return f"data:{TYPES[path.suffix]};base64,{b64encode(path.read_bytes()).decode()}"
