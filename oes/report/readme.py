"""The results block of README.md, from reports/metrics.json.

``python -m oes.report.readme`` writes it between the markers.
"""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from oes.report.metrics import headline_ratios
from oes.report.names import CONTACT_NOTE, LAST
from oes.report.table import markdown
from oes.report.tables import results_table

METRICS_FILE, README = Path("reports/metrics.json"), Path("README.md")
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"


def results_block(tree: Mapping[str, Any]) -> str:
    """Main results as Markdown: one row per model, and the ratios to graph-XYZ."""
    trials = {
        values["trials"]
        for models in tree["mpc"].values()
        for planners in models.values()
        for values in planners.values()
    }
    about = (
        f"Profile {tree['profile']}; novel objects, one random view, predicted boxes. Mean errors "
        f"in mm/deg; success of {' or '.join(map(str, sorted(trials)))} trials with shooting/cem."
    )
    table = markdown(results_table(tree)).split("\n\n", 1)[1].rstrip()
    lines = [*map("- {}".format, headline_ratios(tree)), f"- {CONTACT_NOTE}"]
    return "\n\n".join([about, table, f"Ratios of mean errors, T = {LAST}:", "\n".join(lines)])


def with_results(text: str, tree: Mapping[str, Any]) -> str:
    """The text with the block between its markers renewed. Raises ValueError without markers."""
    pattern = re.compile(f"{BEGIN}.*?{END}", re.DOTALL)
    if not pattern.search(text):
        raise ValueError(f"no {BEGIN} ... {END} to write the results into")
    return pattern.sub(lambda _: f"{BEGIN}\n{results_block(tree)}\n{END}", text, count=1)


if __name__ == "__main__":
    numbers = json.loads(METRICS_FILE.read_text(encoding="utf-8"))
    README.write_text(with_results(README.read_text(encoding="utf-8"), numbers), encoding="utf-8")
