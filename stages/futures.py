"""futures: forecasts drawn into the feature map and decoded, of scenes as they were and changed;
held to the truth.
"""

import shutil
from pathlib import Path

import torch

from oes.cli import run
from oes.counterfactual.counterfactuals import EDIT_COLUMNS
from oes.counterfactual.evaluate import CONSISTENCY_COLUMNS, RENDER_COLUMNS
from oes.counterfactual.study import FUTURES_TABLES, FuturesConfig, FuturesRunner
from oes.csv_io import write_csv
from oes.dynamics.checkpoint import load_model
from oes.meshes.catalogue import load_catalogue
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.stage import publish, work_dir

MODELS = ("oes", "graph_xyz")
COLUMNS = dict(
    zip(FUTURES_TABLES, (RENDER_COLUMNS, CONSISTENCY_COLUMNS, EDIT_COLUMNS), strict=True)
)


def main(
    cfg: FuturesConfig,
    task: str,
    meshes: Path,
    episodes: Path,
    perception: Path,
    dynamics: Path,
    out: Path,
) -> None:
    """Write a CSV for each of ``FUTURES_TABLES`` and ``gallery/`` to ``out``."""
    with work_dir(out, (cfg, task, [meshes, episodes, perception, dynamics])) as work:
        progress, gallery = work / "progress", work / "gallery"
        for folder in (progress, gallery):
            folder.mkdir(exist_ok=True)
        models = {word: load_model(dynamics / f"{task}-{word}") for word in MODELS}
        perceiver = Perceiver.load(perception / "perception.safetensors", torch.device("cpu"))
        source = FrameSource(episodes / f"{task}-{cfg.splits[task]}")
        study = FuturesRunner(cfg, task, load_catalogue(meshes), perceiver, source, models)
        for name, rows in study.run(progress, gallery).items():
            write_csv(work / f"{name}.csv", rows, COLUMNS[name])
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
