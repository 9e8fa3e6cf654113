"""Guards over the shape of the repository: each takes a root folder and returns its complaints,
empty when all is well.

`python -m tests.architecture` rewrites the code under every stage's `deps` in dvc.yaml to what
the stage reaches.
"""

import ast
import itertools
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from oes.stage import imports, reached

# From the bottom up: a module or package of oes may import only those before it.
ORDER = (
    "config", "schema", "jit", "episode", "geom", "objects", "csv_io", "progress", "cli", "stage",
    "metrics", "training", "viz", "report", "meshes", "sim", "render", "record", "episodes",
    "perception", "dynamics", "baselines", "mpc", "evaluation", "counterfactual", "trials",
    "apps",
)  # fmt: skip

# Libraries that only some packages may import.
OWNERS = {
    "pybullet": {"sim"},
    "pybullet_data": {"sim"},
    "pybullet_utils": {"sim"},
    "mcap": {"record"},
    "rosbags": {"record"},
    "matplotlib": {"report", "render", "episodes"},
    "torch": {
        "geom",
        "objects",
        "metrics",
        "training",
        "perception",
        "dynamics",
        "baselines",
        "mpc",
        "evaluation",
    }
    | {"counterfactual", "trials", "apps", "stages"},
    "viser": {"apps"},
    "pickle": set[str](),
}

# What a package may not reach, however indirectly: parts of oes, or libraries.
APART = {
    "mpc": {"sim", "render", "record", "perception", "meshes", "pybullet"},
    "dynamics": {"sim", "render", "record", "pybullet"},
    "report": {"training.loop", "sim", "perception", "dynamics", "pybullet"},
}

PROFILES = ("params.yaml", "params.smoke.yaml", "params.paper.yaml")


def part_of(path: Path, root: Path) -> str:
    """`oes/geom/se3.py` -> `geom`, `oes/stage.py` -> `stage`, `oes/__init__.py` -> ``."""
    return path.relative_to(root / "oes").parts[0].removesuffix(".py").replace("__init__", "")


def sources(root: Path) -> list[Path]:
    return sorted(path for path in (root / "oes").rglob("*.py"))


def layers(root: Path) -> Iterator[str]:
    """Imports point downward, lazy ones too."""
    for path in sources(root):
        part = part_of(path, root)
        for name in sorted(imports(path)):
            other = name.split(".")[1] if name.startswith("oes.") else part
            if part in ORDER and other in ORDER and ORDER.index(other) > ORDER.index(part):
                yield f"{path.relative_to(root)} imports upward: {name}"
            if name.split(".")[0] in ("stages", "tests", "benchmarks"):
                yield f"{path.relative_to(root)} imports upward: {name}"


def rules(root: Path) -> Iterator[str]:
    """Every module and package of oes has its place in ORDER; oes/__init__.py is a text, which no
    stage depends on.
    """
    for part in sorted({part_of(path, root) for path in sources(root)} - {"", *ORDER}):
        yield f"oes/{part} has no place in ORDER (tests/architecture.py)"
    if len(ast.parse((root / "oes/__init__.py").read_text(encoding="utf-8")).body) > 1:
        yield "oes/__init__.py holds more than its docstring"


def owners(root: Path) -> Iterator[str]:
    """Only sim imports pybullet, only record imports mcap, and so on."""
    for path in sources(root) + sorted((root / "stages").glob("*.py")):
        part = part_of(path, root) if path.is_relative_to(root / "oes") else "stages"
        for library in sorted({name.split(".")[0] for name in imports(path)} & OWNERS.keys()):
            if part not in OWNERS[library]:
                allowed = sorted(OWNERS[library])
                yield f"{path.relative_to(root)} imports {library}: only {allowed} may"


def isolation(root: Path) -> Iterator[str]:
    """Planning cannot see the simulator, however indirectly; nor can reports need a model."""
    for part, forbidden in APART.items():
        start = [path for path in sources(root) if part_of(path, root) == part]
        for path in sorted(reached(start, root)):
            names = {name.split(".")[0] for name in imports(path)} | {part_of(path, root)}
            names.add(".".join(path.relative_to(root / "oes").with_suffix("").parts))
            for name in sorted(names & forbidden):
                yield f"oes/{part} reaches {name} through {path.relative_to(root)}"


def stage_names(root: Path) -> Iterator[str]:
    """The same words in dvc.yaml, stages/ and the sections of params.yaml (which may serve
    modules of oes too).
    """
    stages, modules = set(pipeline(root)), {path.stem for path in (root / "stages").glob("*.py")}
    sections = set(yaml.safe_load((root / "params.yaml").read_text(encoding="utf-8")))
    for stage_name in sorted(stages ^ modules):
        yield f"{stage_name}: in only one of dvc.yaml and stages/"
    for stage_name in sorted(stages - sections):
        yield f"{stage_name}: a stage without a section in params.yaml"
    for stage_name in sorted(sections - stages):
        if not any(
            (root / f"oes/{name}").exists() for name in (stage_name, f"apps/{stage_name}.py")
        ):
            yield f"{stage_name}: a section of params.yaml without a stage, app or package"


def deps(root: Path) -> Iterator[str]:
    """The code under deps is exactly what the stage reaches: DVC keeps a stale output when
    something is unlisted.
    """
    for stage_name, stage in written(root).items():
        code = [dep for dep in stage["deps"] if not dep.startswith("datasets/")]
        if set(code) != set(wanted := code_deps(root, stage_name)) or len(code) != len(wanted):
            command = "python -m tests.architecture writes them"
            yield f"{stage_name}: its deps must be ({command}):\n{block(root, stage_name)}"


def code_deps(root: Path, stage_name: str) -> list[str]:
    """The stage's own file, then the modules and packages of oes that it reaches."""
    stage = root / f"stages/{stage_name}.py"
    parts = {
        part_of(path, root)
        for path in reached([stage], root)
        if path.is_relative_to((root / "oes").resolve())
    }
    names = [
        f"oes/{part}.py" if (root / f"oes/{part}.py").exists() else f"oes/{part}"
        for part in sorted(parts - {""})
    ]
    return [f"stages/{stage_name}.py", *names]


def block(root: Path, stage_name: str, indent: str = "    ") -> str:
    data = [dep for dep in pipeline(root)[stage_name]["deps"] if dep.startswith("datasets/")]
    return "".join(
        f"{indent}{line}\n"
        for line in ["deps:", *(f"  - {dep}" for dep in code_deps(root, stage_name) + data)]
    )


def commands(root: Path) -> Iterator[str]:
    """Each cmd runs its stage with the flags of its main, and every path in it is declared."""
    for stage_name, stage in written(root).items():
        python, m, module, *flags = shlex.split(stage["cmd"])
        given = {
            flag.removeprefix("--"): value
            for flag, value in zip(flags[::2], flags[1::2], strict=True)
        }
        kinds = main_flags(root / f"stages/{stage_name}.py")
        if (python, m, module) != ("python", "-m", f"stages.{stage_name}"):
            yield f"{stage_name}: its cmd does not run stages.{stage_name}"
        if given.keys() != kinds.keys():
            yield f"{stage_name}: its cmd has flags {sorted(given)}, its main {sorted(kinds)}"
        paths = {
            value for flag, value in given.items() if kinds.get(flag) == "Path" and flag != "out"
        }
        data = {dep for dep in stage["deps"] if dep.startswith("datasets/")}
        for path in sorted(paths):
            if not any(dep == path or dep.startswith(f"{path}/") for dep in data):
                yield f"{stage_name}: {path} is in its cmd, not in its deps"
        for dep in sorted(data):
            if not any(dep == path or dep.startswith(f"{path}/") for path in paths):
                yield f"{stage_name}: {dep} is in its deps, not in its cmd"
        if given.get("out") not in outs(stage):
            yield f"{stage_name}: --out {given.get('out')} is not in its outs"


def produced(root: Path) -> Iterator[str]:
    """Every data dep of every instance is the output of some instance."""
    stages = pipeline(root)
    made = {path for stage in stages.values() for path in expand(outs(stage), stage)}
    for stage_name, stage in stages.items():
        for dep in sorted(
            expand([dep for dep in stage["deps"] if dep.startswith("datasets/")], stage) - made
        ):
            yield f"{stage_name}: no stage makes {dep}"


def profiles(root: Path) -> Iterator[str]:
    """Every profile has the same keys; the values of lists may differ."""
    trees = {name: yaml.safe_load((root / name).read_text(encoding="utf-8")) for name in PROFILES}
    first = set(keys(trees[PROFILES[0]]))
    for name in PROFILES[1:]:
        for key in sorted(first ^ set(keys(trees[name]))):
            yield f"{key}: in only one of {PROFILES[0]} and {name}"


def keys(tree: Any, prefix: str = "") -> Iterator[str]:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield f"{prefix}{key}"
            yield from keys(value, f"{prefix}{key}.")


def pipeline(root: Path) -> dict[str, Any]:
    """The stages by name; a foreach ... do is flattened to its do, with the foreach beside it."""
    stages: dict[str, Any] = yaml.safe_load((root / "dvc.yaml").read_text(encoding="utf-8"))[
        "stages"
    ]
    return {stage_name: {**stage.pop("do", {}), **stage} for stage_name, stage in stages.items()}


def written(root: Path) -> dict[str, Any]:
    """The stages of dvc.yaml that have their module; `words` names the others."""
    return {
        stage_name: stage
        for stage_name, stage in pipeline(root).items()
        if (root / f"stages/{stage_name}.py").exists()
    }


def outs(stage: dict[str, Any]) -> list[str]:
    return [next(iter(out)) if isinstance(out, dict) else out for out in stage["outs"]]


def expand(paths: list[str], stage: dict[str, Any]) -> set[str]:
    """The paths of every instance of a stage."""
    matrix = stage.get("matrix", {})
    product = [
        dict(zip(matrix, values, strict=True)) for values in itertools.product(*matrix.values())
    ]
    items = list(stage.get("foreach", {}).values()) or product
    return {_filled(path, item) for path in paths for item in items}


def _filled(path: str, item: dict[str, Any]) -> str:
    return re.sub(r"\$\{item\.(\w+)\}", lambda match: str(item[match[1]]), path)


def main_flags(path: Path) -> dict[str, str]:
    """The arguments of a stage's main after cfg, with their annotations, read from its source."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    main = next(
        node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "main"
    )
    return {arg.arg: ast.unparse(arg.annotation) for arg in main.args.args[1:] if arg.annotation}


def rewrite_deps(root: Path) -> None:
    """Put the code that each stage reaches into dvc.yaml, before the data it reads."""
    path = root / "dvc.yaml"
    text = path.read_text(encoding="utf-8")
    for stage_name in written(root):
        pattern = rf"(?ms)(^  {stage_name}:\n.*?)^( +)deps:\n(?:\2  - .*?\n)+"
        match = re.search(pattern, text)
        assert match, stage_name
        new = match[1] + block(root, stage_name, match[2])
        text = text[: match.start()] + new + text[match.end() :]
    path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    rewrite_deps(Path(__file__).parents[1])
