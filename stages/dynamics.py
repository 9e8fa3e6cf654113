"""dynamics: one model of object motion, trained through its unroll on perceived training scenes."""

import shutil
from pathlib import Path

from oes.dynamics import MODELS, VARIANTS
from oes.dynamics.checkpoint import save_model
from oes.dynamics.learn import learn
from oes.dynamics.train import Tasks
from oes.percept.store import read_objects
from oes.record.dataset import read_states
from oes.rows import columns_of, write_csv
from oes.stage import StageError, publish, run, work_dir


def main(cfg: Tasks, task: str, model: str, episodes: Path, objects: Path, out: Path) -> None:
    """Write ``model.safetensors`` and ``log.csv`` to ``out``."""
    if model not in (known := [*MODELS, *VARIANTS]):
        raise StageError(f"unknown model {model!r}; there are: {', '.join(known)}")
    settings = cfg.of(task)
    with work_dir(out, (settings, task, model, [episodes, objects])) as work:
        scenes = read_objects(objects / "objects.safetensors")
        recorded = dict(enumerate(read_states(episodes)))
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        learned, log = learn(model, settings, scenes, recorded, progress)
        save_model(work, learned)
        write_csv(work / "log.csv", log, columns_of(log) or ["step"])
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
