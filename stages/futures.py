"""futures: counterfactual forecasts, composed and decoded; errors against Bullet, and a gallery."""

import shutil
from pathlib import Path

import torch

from oes.cli import run
from oes.counterfactual.runner import FuturesConfig, FuturesRunner
from oes.csv_io import write_csv
from oes.dynamics.checkpoint import load_model
from oes.meshes.catalogue import load_catalogue
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.schema import FUTURES
from oes.stage import publish, work_dir

MODELS = ("oes", "graph_xyz")


def main(
    cfg: FuturesConfig,
    task: str,
    meshes: Path,
    episodes: Path,
    perception: Path,
    dynamics: Path,
    out: Path,
) -> None:
    """Write a CSV for each of ``oes.schema.FUTURES`` and ``gallery/`` to ``out``."""
    with work_dir(out, (cfg, task, [meshes, episodes, perception, dynamics])) as work:
        progress, gallery = work / "progress", work / "gallery"
        for folder in (progress, gallery):
            folder.mkdir(exist_ok=True)
        models = {name: load_model(dynamics / f"{task}-{name}") for name in MODELS}
        perceiver = Perceiver.load(perception / "perception.safetensors", torch.device("cpu"))
        source = FrameSource(episodes / f"{task}-{cfg.splits[task]}")
        runner = FuturesRunner(cfg, task, load_catalogue(meshes), perceiver, source, models)
        for name, rows in runner.run(progress, gallery).items():
            write_csv(work / f"{name}.csv", rows, FUTURES[name])
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
