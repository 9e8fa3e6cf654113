"""dynamics: train one model of object motion on the perceived training scenes."""

import shutil
from pathlib import Path

from oes.cli import run
from oes.csv_io import columns_of, write_csv
from oes.dynamics.checkpoint import save_model
from oes.dynamics.learn import build_model, resolve_model
from oes.dynamics.train import DynamicsConfig
from oes.perception.objects_file import read_objects
from oes.record.dataset import read_states
from oes.stage import publish, work_dir


def main(
    cfg: DynamicsConfig, task: str, model: str, episodes: Path, objects: Path, out: Path
) -> None:
    """Write ``model.safetensors`` and ``log.csv`` to ``out``."""
    spec = resolve_model(model, cfg.of(task))
    with work_dir(out, (cfg.of(task), task, model, [episodes, objects])) as work:
        scenes = read_objects(objects / "objects.safetensors")
        recorded = dict(enumerate(read_states(episodes)))
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        trained, log = build_model(spec, scenes, recorded, progress)
        save_model(work, trained)
        write_csv(work / "log.csv", log, columns_of(log) or ["step"])
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
