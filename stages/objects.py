"""objects: every episode's first state as perception sees it, under every setting; at test, scored
too.
"""

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
    """Write ``objects.safetensors`` and, for test splits, ``detections.csv`` and ``views.csv`` to
    ``out``.
    """
    is_train = split == TRAIN
    with work_dir(out, (cfg, task, split, [meshes, episodes, perception])) as work:
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        perceiver = Perceiver.load(perception / "perception.safetensors", device)
        catalogue = load_catalogue(meshes)
        shells = GroundTruthProfiles(catalogue, perceiver.net.cfg.surface.cylinder)
        solids = None if is_train else solids_of(catalogue, cfg.num_solid_points)
        observer = ScenePerceiver(
            cfg, cfg.settings(task, split), perceiver, FrameSource(episodes), shells, solids
        )
        tensors, detections, views = perceive_split(observer, progress)
        write_objects(work / "objects.safetensors", tensors, list(observer.settings))
        if not is_train:
            for name, columns, rows in (
                ("detections", DETECTIONS, detections),
                ("views", VIEWS, views),
            ):
                write_csv(work / f"{name}.csv", rows, columns)
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
