"""rollouts: one model unrolled on every test split and setting; every error of every step is kept as a row."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

from oes.dynamics.checkpoint import load
from oes.meshes.catalogue import load_catalogue
from oes.percept.store import read_objects
from oes.record.dataset import read_states
from oes.rollout import COLUMNS, Rollouts, forecaster, split_rows
from oes.rows import write_csv
from oes.stage import publish, run, work_dir


def main(
    cfg: Rollouts, task: str, model: str, meshes: Path, episodes: Path, objects: Path, dynamics: Path, out: Path
) -> None:
    """Write ``errors.csv`` to ``out``."""
    forecast = forecaster(load(dynamics), load_catalogue(meshes), cfg)

    def rows() -> Iterator[dict[str, object]]:
        for split in tqdm(cfg.settings, unit="split", disable=None):
            store = read_objects(objects / f"{task}-{split}" / "objects.safetensors")
            recorded = dict(enumerate(read_states(episodes / f"{task}-{split}")))
            yield from map(asdict, split_rows(forecast, store, recorded, (task, model, split), cfg))

    with work_dir(out, (cfg, task, model, [meshes, episodes, objects, dynamics])) as work:
        write_csv(work / "errors.csv", rows(), COLUMNS)
        publish(work, out)


if __name__ == "__main__":
    run(main)
