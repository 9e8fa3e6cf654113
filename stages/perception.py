"""perception: views to a 3D feature map, the objects in it and images of it, trained on all states of the episodes."""

import shutil
from pathlib import Path

import torch

from oes.meshes.catalogue import load_catalogue
from oes.percept.solids import solids_of
from oes.percept.train import Perception, train
from oes.record.dataset import FrameSource
from oes.rows import columns_of, write_csv
from oes.stage import publish, run, work_dir


def main(cfg: Perception, meshes: Path, episodes: Path, out: Path) -> None:
    """Write ``perception.safetensors`` (its config in the metadata) and ``log.csv`` to ``out``."""
    with work_dir(out, (cfg, [meshes, episodes])) as work:
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        source = FrameSource(*(episodes / f"{task}-train" for task in cfg.tasks))
        solids = solids_of(load_catalogue(meshes), cfg.num_solid_points)
        perceiver, log = train(cfg, source, solids, progress, device)
        perceiver.save(work / "perception.safetensors")
        write_csv(work / "log.csv", log, columns_of(log))
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
