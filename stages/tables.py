"""tables: the raw rows of all stages as tables, figures, pages and metrics, with the weights."""

from pathlib import Path

from oes.cli import run
from oes.config import PARAMS
from oes.report.build import build
from oes.report.inputs import Inputs, TablesConfig
from oes.report.provenance import read_seeds
from oes.stage import publish, work_dir


def main(
    cfg: TablesConfig,
    meshes: Path,
    episodes: Path,
    perception: Path,
    objects: Path,
    dynamics: Path,
    rollouts: Path,
    futures: Path,
    trials: Path,
    out: Path,
) -> None:
    """Write the whole report to ``out``."""
    inputs = Inputs(meshes, episodes, perception, objects, dynamics, rollouts, futures, trials)
    with work_dir(out, (cfg, [rollouts, futures, trials, objects, dynamics, perception])) as work:
        build(cfg, inputs, read_seeds(PARAMS), work)
        publish(work, out)


if __name__ == "__main__":
    run(main)
