"""perception: train the perception network on all states of the episodes, then its surface head."""

import shutil
from pathlib import Path

import torch

from oes.cli import run
from oes.csv_io import columns_of, write_csv
from oes.meshes.catalogue import load_catalogue
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.solids import solids_of
from oes.perception.surface_training import SurfaceSampler, train_surface
from oes.perception.train import PerceptionConfig, train_perception
from oes.record.dataset import FrameSource
from oes.stage import publish, work_dir


def main(cfg: PerceptionConfig, meshes: Path, episodes: Path, out: Path) -> None:
    """Write ``perception.safetensors``, ``log.csv`` and ``surface.csv`` to ``out``."""
    with work_dir(out, (cfg, [meshes, episodes])) as work:
        progress = work / "progress"
        (progress / "surface").mkdir(parents=True, exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        source = FrameSource(*(episodes / f"{task}-train" for task in cfg.tasks))
        catalogue = load_catalogue(meshes)
        solids = solids_of(catalogue, cfg.num_solid_points)
        gt_profiles = GroundTruthProfiles(catalogue, cfg.network.surface.cylinder)
        perceiver, log = train_perception(cfg, source, solids, progress, device)
        sampler = SurfaceSampler(perceiver, source, gt_profiles, cfg.surface)
        split = cfg.split(len(source.episodes))
        surface_log = train_surface(sampler, split, progress / "surface")
        perceiver.save(work / "perception.safetensors")
        for name, rows in (("log", log), ("surface", surface_log)):
            write_csv(work / f"{name}.csv", rows, columns_of(rows))
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
