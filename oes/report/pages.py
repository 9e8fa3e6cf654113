"""The pages of the report: which tables and media each holds, and their Markdown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from oes.report.figures import Media
from oes.report.table import TableGroup, markdown


@dataclass(frozen=True)
class PageSpec:
    """A page: its name, title, text, and how the names of its table groups begin."""

    name: str
    title: str
    text: str
    groups: tuple[str, ...]


PAGES = (
    PageSpec(
        "pushing",
        "Forecasts of pushed objects",
        "Errors of the forecast pose of each object after T pushes. All models perceive the same "
        "images; the simulator starts from the true state with nominal mass and friction.",
        ("table1", "ratios", "by-objects", "by-views", "ablations"),
    ),
    PageSpec(
        "falling",
        "Forecasts of falling objects",
        "Errors of the forecast pose of each object after T steps of a fall.",
        ("table2", "ratios-falling", "by-objects-falling"),
    ),
    PageSpec(
        "moved",
        "Forecasts of objects that moved",
        "The same errors over the objects that the push or the impact moved.",
        ("table1-moved", "table2-moved"),
    ),
    PageSpec(
        "uncertainty",
        "Calibration and plausibility",
        "Contact samples surfaces, masses and frictions; the spread of the sampled futures gives "
        "its uncertainty. Penetration and motion of static objects measure physical plausibility.",
        ("calibration", "plausibility"),
    ),
    PageSpec(
        "mpc",
        "Model predictive control",
        "The robot plans pushes with a model's forecasts, executes one, and observes again. Films "
        "show the input image, the plan and the predicted positions.",
        ("table3",),
    ),
    PageSpec(
        "perception",
        "Perception and image-forecasting baselines",
        "Detection and completion of novel objects, prediction of unseen views, and the accuracy "
        "of the baselines that forecast images.",
        ("detector", "view-prediction", "image-forecasts"),
    ),
    PageSpec(
        "futures",
        "Rendered and counterfactual futures",
        "Features of objects are moved to their forecast poses and decoded for any camera. The "
        "orange line is the rod; the robot's own features stay in place. Edited scenes compare "
        "forecasts with Bullet.",
        ("futures", "consistency", "counterfactuals"),
    ),
    PageSpec(
        "data",
        "Data and training",
        "Objects, their motion in the episodes, and training curves.",
        ("data",),
    ),
)


@dataclass(frozen=True)
class Page:
    """A page with its contents."""

    spec: PageSpec
    groups: tuple[TableGroup, ...]
    figures: tuple[Media, ...]
    films: tuple[Media, ...]


def fill_pages(groups: Mapping[str, TableGroup], media: Sequence[Media]) -> list[Page]:
    """The pages that have any content."""
    pages = []
    for spec in PAGES:
        own = [group for name, group in groups.items() if _page_of(name) == spec.name]
        here = [each for each in media if each.page == spec.name]
        films = tuple(each for each in here if each.path.endswith(".mp4"))
        figures = tuple(each for each in here if each not in films)
        if own or here:
            pages.append(Page(spec, tuple(own), figures, films))
    return pages


def _page_of(group: str) -> str:
    """The page with the longest matching beginning: ``ratios-falling`` is not of pushing."""
    starts = {start: spec.name for spec in PAGES for start in spec.groups}
    return starts[max((start for start in starts if group.startswith(start)), key=len)]


def page_markdown(page: Page) -> str:
    """A page as Markdown; films are links, since GitHub does not play files of a repository."""
    parts = [f"# {page.spec.title}", page.spec.text]
    shown: set[str] = set()
    for group in page.groups:
        parts.append(f"## {group.title}")
        parts += map(markdown, group.tables)
        # A note that is the same under several groups stands once.
        parts += [note for note in group.notes if note not in shown]
        shown |= set(group.notes)
        parts.append(
            f"[{group.name}.csv](tables/{group.name}.csv), [LaTeX](tables/{group.name}.tex)"
        )
    if page.figures:
        parts.append("## Figures")
        parts += [f"![{each.caption}]({each.path})\n\n{each.caption}" for each in page.figures]
    if page.films:
        links = [f"- [{each.caption}]({each.path})" for each in page.films]
        parts += ["## Films", "\n".join(links)]
    return "\n\n".join(part.rstrip() for part in parts) + "\n\n[All results](README.md)\n"


def index_markdown(opening: Sequence[str], results: str, pages: Sequence[Page]) -> str:
    """The index: opening lines (provenance), main results, and links to all pages."""
    links = [f"- [{page.spec.title}]({page.spec.name}.md). {page.spec.text}" for page in pages]
    files = (
        "[index.html](index.html) holds tables, figures and films in one file (download it to "
        "open it). Numbers for programs: [metrics.json](metrics.json) has all of them, "
        "[summary.json](summary.json) those of `dvc metrics show`, `tables/` those of each table."
    )
    return "\n\n".join(["# Results", *opening, results.strip(), "\n".join(links), files]) + "\n"


def write_pages(pages: Sequence[Page], opening: Sequence[str], results: str, out: Path) -> None:
    """``README.md`` and a file per page."""
    (out / "README.md").write_text(index_markdown(opening, results, pages), encoding="utf-8")
    for page in pages:
        (out / f"{page.spec.name}.md").write_text(page_markdown(page), encoding="utf-8")
