"""rollouts: unroll one model on every test split and perception setting; keep every error."""

from collections.abc import Iterator
from pathlib import Path

from PIL import Image
from tqdm import tqdm

from oes.cli import run
from oes.csv_io import write_csv
from oes.dynamics.checkpoint import load_any_model
from oes.evaluation.evaluate_forecasts import Row, error_rows, mesh_geometry, scored_settings
from oes.evaluation.filmstrips import render_filmstrips
from oes.evaluation.forecasters import RolloutsConfig, make_forecaster, with_oracle_shapes
from oes.meshes.catalogue import load_catalogue
from oes.perception.objects_file import read_objects
from oes.record.dataset import read_states
from oes.schema import ERRORS
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
    """Write ``errors.csv`` and the film strips ``scenes/<split>-<episode>.png`` to ``out``."""
    catalogue, trained = load_catalogue(meshes), load_any_model(dynamics)
    forecaster = make_forecaster(trained, catalogue, cfg)
    geometry = mesh_geometry(catalogue, cfg.num_surface_points)

    def rows(folder: Path) -> Iterator[Row]:
        for split in tqdm(scored_settings(cfg, model), unit="split", disable=None):
            store = read_objects(objects / f"{task}-{split}" / "objects.safetensors")
            store = with_oracle_shapes(trained, store)
            recorded = dict(enumerate(read_states(episodes / f"{task}-{split}")))
            names = (task, model, split)
            yield from error_rows(forecaster, store, recorded, geometry, names, cfg)
            if split == cfg.filmstrips.splits[task]:
                strips = render_filmstrips(forecaster, store, recorded, catalogue, cfg)
                for episode_i, image in strips:
                    Image.fromarray(image).save(folder / f"{split}-{episode_i:06d}.png")

    with work_dir(out, (cfg, task, model, [meshes, episodes, objects, dynamics])) as work:
        (work / "scenes").mkdir(exist_ok=True)
        write_csv(work / "errors.csv", rows(work / "scenes"), ERRORS)
        publish(work, out)


if __name__ == "__main__":
    run(main)
