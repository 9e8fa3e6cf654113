"""rollouts: one model unrolled on every test split and setting; every error of every step is kept as a row."""

import csv
from dataclasses import asdict
from pathlib import Path

from oes.dynamics.checkpoint import load
from oes.meshes.catalogue import load_catalogue
from oes.percept.store import read_objects
from oes.record.reader import list_episodes, read_episode
from oes.rollout import COLUMNS, Rollouts, forecaster, split_rows
from oes.stage import publish, run, work_dir


def main(
    cfg: Rollouts, task: str, model: str, meshes: Path, episodes: Path, objects: Path, dynamics: Path, out: Path
) -> None:
    """Write ``errors.csv`` to ``out``."""
    forecast = forecaster(load(dynamics), load_catalogue(meshes), cfg)
    with work_dir(out, (cfg, task, model, [meshes, episodes, objects, dynamics])) as work:
        with (work / "errors.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            for split in cfg.settings:
                store = read_objects(objects / f"{task}-{split}" / "objects.safetensors")
                folders = list_episodes(episodes / f"{task}-{split}")
                seen = sorted({store.episode(draw_i) for draw_i in range(len(store))})
                recorded = {episode_i: read_episode(folders[episode_i]) for episode_i in seen}
                rows = split_rows(forecast, store, recorded, (task, model, split), cfg)
                writer.writerows(asdict(row) for row in rows)
        publish(work, out)


if __name__ == "__main__":
    run(main)
