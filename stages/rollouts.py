"""rollouts: one model unrolled on every test split and setting; every error of every step is kept
as a row.
"""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from PIL import Image
from tqdm import tqdm

from oes.cli import run
from oes.csv_io import write_csv
from oes.dynamics.checkpoint import load_any_model
from oes.evaluation.evaluate_forecasts import (
    ERROR_COLUMNS,
    penetration_meter,
    sample_mesh_surfaces,
    settings_of,
    split_rows,
    strips,
)
from oes.evaluation.forecasters import RolloutsConfig, make_forecaster, with_oracle_shapes
from oes.meshes.catalogue import load_catalogue
from oes.perception.objects_file import read_objects
from oes.record.dataset import read_states
from oes.stage import publish, work_dir


def main(
    cfg: RolloutsConfig,
    task: str,
    model: str,
    meshes: Path,
    episodes: Path,
    objects: Path,
    dynamics: Path,
    out: Path,
) -> None:
    """Write ``errors.csv`` and ``scenes/<split>-<episode>.png`` to ``out``."""
    catalogue = load_catalogue(meshes)
    learned = load_any_model(dynamics)
    forecast = make_forecaster(learned, catalogue, cfg)
    surfaces = sample_mesh_surfaces(catalogue, cfg.num_surface_points)
    overlaps = penetration_meter(catalogue, surfaces)

    def rows(pictures: Path) -> Iterator[dict[str, object]]:
        for split in tqdm(settings_of(cfg, model), unit="split", disable=None):
            store = with_oracle_shapes(
                learned, read_objects(objects / f"{task}-{split}" / "objects.safetensors")
            )
            recorded = dict(enumerate(read_states(episodes / f"{task}-{split}")))
            words = (task, model, split)
            yield from map(
                asdict, split_rows(forecast, store, recorded, surfaces, overlaps, words, cfg)
            )
            if split == cfg.strips.splits[task]:
                for episode_i, picture in strips(forecast, store, recorded, catalogue, cfg):
                    Image.fromarray(picture).save(pictures / f"{split}-{episode_i:06d}.png")

    with work_dir(out, (cfg, task, model, [meshes, episodes, objects, dynamics])) as work:
        (work / "scenes").mkdir(exist_ok=True)
        write_csv(work / "errors.csv", rows(work / "scenes"), ERROR_COLUMNS)
        publish(work, out)


if __name__ == "__main__":
    run(main)
