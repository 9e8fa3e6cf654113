"""perception: views to a 3D feature map, the objects in it and images of it, trained on all states
of the episodes.
"""

import shutil
from pathlib import Path

import torch

from oes.cli import run
from oes.csv_io import columns_of, write_csv
from oes.meshes.catalogue import load_catalogue
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.solids import solids_of
from oes.perception.train import PerceptionConfig, train_perception
from oes.record.dataset import FrameSource
from oes.stage import publish, work_dir


def main(cfg: PerceptionConfig, meshes: Path, episodes: Path, out: Path) -> None:
    """Write ``perception.safetensors`` (its config in the metadata), ``log.csv`` and
    ``surface.csv`` to ``out``.
    """
    with work_dir(out, (cfg, [meshes, episodes])) as work:
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        source = FrameSource(*(episodes / f"{task}-train" for task in cfg.tasks))
        catalogue = load_catalogue(meshes)
        solids, gt_profiles = (
            solids_of(catalogue, cfg.num_solid_points),
            GroundTruthProfiles(catalogue, cfg.network.surface.cylinder),
        )
        perceiver, log, surface_log = train_perception(
            cfg, source, solids, gt_profiles, progress, device
        )
        perceiver.save(work / "perception.safetensors")
        for name, rows in (("log", log), ("surface", surface_log)):
            write_csv(work / f"{name}.csv", rows, columns_of(rows))
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
