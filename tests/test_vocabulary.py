"""Names: a public name means one thing, shape letters are defined, terms are the field's."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

import oes

ROOT = Path(__file__).parents[1]
SOURCES = sorted((ROOT / "oes").rglob("*.py"))
EVERYWHERE = {"main", "log"}  # entry points and loggers

# Words of an earlier private dialect, which a roboticist would not guess.
DIALECT = (
    "mind", "minds", "eyes", "heft", "doubt", "told", "foretell", "foretells", "foresee",
    "foreseen", "errs", "rattles", "betters", "lessons", "redrawn", "belief", "contest",
    "workbench", "photographer", "photos", "backdrop", "toll", "aversion", "shortlist",
    "likeness", "shells", "skins", "imagenet", "sight", "relief", "take_apart", "designate",
    "seen_by", "carried", "halving", "at_rest", "single_steps", "mishap", "believed_mm",
    "nll_same", "scale_mm", "contact_true", "contact_still", "contact_step", "draws_futures",
    "certainty", "painter", "whatif",
)  # fmt: skip


def public_names(path: Path) -> Iterator[str]:
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        match node:
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                yield name
            case ast.Assign(targets=targets):
                yield from (x.id for t in targets for x in ast.walk(t) if isinstance(x, ast.Name))
            case ast.AnnAssign(target=ast.Name(id=name)):
                yield name


def test_every_public_name_is_defined_once() -> None:
    places = defaultdict(list)
    for path in SOURCES:
        for name in public_names(path):
            if not name.startswith("_") and name not in EVERYWHERE:
                places[name].append(str(path.relative_to(ROOT)))
    assert {name: paths for name, paths in places.items() if len(paths) > 1} == {}


def test_shape_letters_are_the_defined_ones() -> None:
    text = " ".join(str(oes.__doc__).split())
    letters = set(re.findall(r"\b([A-Z]) (?=[a-z(])", text[text.index("Shape letters") :]))
    letters |= set("HWXYZ") - {"K"}
    wrong = defaultdict(set)
    for path in SOURCES:
        for name in re.findall(
            r"\b[a-z][a-zA-Z]*(?:_[a-z0-9]+)*_([A-Z0-9]*[A-Z][A-Z0-9]*)\b", path.read_text()
        ):
            if stray := set(re.findall("[A-Z]", name)) - letters:
                wrong[str(path.relative_to(ROOT))].add(f"{name}: {''.join(sorted(stray))}")
    assert dict(wrong) == {}


@pytest.mark.parametrize(
    "folder",
    ["oes", "stages", "benchmarks", "docs", "README.md", "params.yaml", "dvc.yaml", "Makefile"],
)
def test_no_word_of_the_dialect(folder: str) -> None:
    pattern = re.compile(rf"(?<![a-zA-Z])(?:{'|'.join(DIALECT)})(?![a-zA-Z])", re.IGNORECASE)
    top = ROOT / folder
    paths = (
        [top]
        if top.is_file()
        else [p for s in ("*.py", "*.md", "*.jinja") for p in sorted(top.rglob(s))]
    )
    found = {
        str(path.relative_to(ROOT)): words
        for path in paths
        if (words := set(pattern.findall(path.read_text(encoding="utf-8"))))
    }
    assert found == {}
