"""reports/README.md: the tables and pictures on one page."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from oes.report.names import METRICS, SETTINGS
from oes.report.study import Forecasts
from oes.report.table import Table, markdown


def headline(found: Forecasts, setting: str, T: int) -> str:
    """What a study is judged by, in a sentence: the error of oes over that of graph_xyz."""
    parts = [
        f"{METRICS[metric].split(' (')[0]} {value[0]:.2f} [{value[1]:.2f}, {value[2]:.2f}]"
        for (key, metric, step), value in found.ratios.items()
        if (key, step) == (setting, T)
    ]
    about = f"{found.study.task}, {found.study.scenes}, {SETTINGS[setting]}, T = {T}"
    return f"3D-OES over graph-XYZ ({about}), ratio of mean errors: {', '.join(parts) or 'none'}."


def write_page(
    path: Path,
    opening: Sequence[str],
    tables: Sequence[Table],
    figures: Mapping[str, str],
    films: Mapping[str, Sequence[str]],
) -> None:
    """``figures`` maps a picture's path, relative to the page, to what it shows; ``films`` a
    heading to such paths.
    """
    parts = ["# Results", *opening]
    parts += [f"## {table.caption}\n\n{_body(table)}" for table in tables]
    parts.append("## Figures")
    parts += [f"{caption}\n\n![{caption}]({name})" for name, caption in figures.items()]
    for heading, names in films.items():
        if names:
            parts.append(f"## {heading}")
            parts += [f"![{Path(name).stem}]({name})" for name in names if name.endswith(".gif")]
            parts.append(
                "\n".join(f"- [{name}]({name})" for name in names if not name.endswith(".gif"))
            )
    path.write_text("\n\n".join(part.rstrip() for part in parts) + "\n", encoding="utf-8")


def _body(table: Table) -> str:
    """The table without its caption, which is the heading, and with links to its other forms."""
    body = markdown(table).split("\n\n", 1)[1].rstrip()
    return f"{body}\n\n[{table.name}.csv]({table.name}.csv), [{table.name}.tex]({table.name}.tex)"
