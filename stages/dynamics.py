"""dynamics: one model of object motion, trained through its unroll on perceived training scenes."""

import shutil
from pathlib import Path

from oes.cli import run
from oes.csv_io import columns_of, write_csv
from oes.dynamics import MODELS, VARIANTS
from oes.dynamics.checkpoint import save_model
from oes.dynamics.learn import build_model
from oes.dynamics.train import DynamicsConfig
from oes.perception.objects_file import read_objects
from oes.record.dataset import read_states
from oes.stage import StageError, publish, work_dir


def main(
    cfg: DynamicsConfig, task: str, model: str, episodes: Path, objects: Path, out: Path
) -> None:
    """Write ``model.safetensors`` and ``log.csv`` to ``out``."""
    if model not in (known := [*MODELS, *VARIANTS]):
        raise StageError(f"unknown model {model!r}; there are: {', '.join(known)}")
    settings = cfg.of(task)
    with work_dir(out, (settings, task, model, [episodes, objects])) as work:
        scenes = read_objects(objects / "objects.safetensors")
        recorded = dict(enumerate(read_states(episodes)))
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        learned, log = build_model(model, settings, scenes, recorded, progress)
        save_model(work, learned)
        write_csv(work / "log.csv", log, columns_of(log) or ["step"])
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
