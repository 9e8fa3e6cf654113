"""objects: the first state of every episode, perceived under every setting; errors at test."""

import shutil
from pathlib import Path

import torch

from oes.cli import run
from oes.csv_io import write_csv
from oes.meshes.catalogue import TRAIN, load_catalogue
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.objects_file import write_objects
from oes.perception.observations import ObjectsConfig, ScenePerceiver, perceive_split
from oes.perception.perceiver import Perceiver
from oes.perception.solids import solids_of
from oes.record.dataset import FrameSource
from oes.schema import DETECTIONS, VIEWS
from oes.stage import publish, work_dir


def main(
    cfg: ObjectsConfig,
    task: str,
    split: str,
    meshes: Path,
    episodes: Path,
    perception: Path,
    out: Path,
) -> None:
    """Write ``objects.safetensors`` and, of a test split, ``detections.csv`` and ``views.csv``."""
    with work_dir(out, (cfg, task, split, [meshes, episodes, perception])) as work:
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        perceiver = Perceiver.load(perception / "perception.safetensors", device)
        catalogue, settings = load_catalogue(meshes), cfg.settings(task, split)
        gt_profiles = GroundTruthProfiles(catalogue, perceiver.net.cfg.surface.cylinder)
        solids = None if split == TRAIN else solids_of(catalogue, cfg.num_solid_points)
        scenes = ScenePerceiver(
            cfg, settings, perceiver, FrameSource(episodes), gt_profiles, solids
        )
        tensors, detections, views = perceive_split(scenes, progress)
        write_objects(work / "objects.safetensors", tensors, list(settings))
        if split != TRAIN:
            write_csv(work / "detections.csv", detections, DETECTIONS)
            write_csv(work / "views.csv", views, VIEWS)
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
