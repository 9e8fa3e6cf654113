"""The results block of README.md is what the command renders from metrics.json."""

import json
from pathlib import Path

import pytest

from oes.report.readme import BEGIN, END, METRICS_FILE, README, with_results

ROOT = Path(__file__).parents[1]


def test_readme_holds_the_results_of_metrics_json() -> None:
    text = (ROOT / README).read_text(encoding="utf-8")
    tree = json.loads((ROOT / METRICS_FILE).read_text(encoding="utf-8"))
    assert with_results(text, tree) == text, "run python -m oes.report.readme"
    block = text.split(BEGIN)[1].split(END)[0]
    assert block.count("\n| ") == 2 + 8, "a header, a rule and eight models"
    assert "3D-OES over graph-XYZ: pushing " in block and "Contact over graph-XYZ: " in block


def test_a_text_without_markers_is_refused() -> None:
    tree = json.loads((ROOT / METRICS_FILE).read_text(encoding="utf-8"))
    with pytest.raises(ValueError, match=r"no <!-- results:begin -->"):
        with_results("# Title\n", tree)
