"""Table 1 on anyone's meshes: ingest, capture two-object test episodes, run the trained models.
Nothing is trained.

``python -m oes.apps.evaluate --meshes FOLDER`` prints the table and writes it to
build/evaluate-<folder's name>/.
"""

import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import torch

from oes.apps.assets import DATASETS, KEPT, find_weights
from oes.cli import run
from oes.config import PARAMS, load, params
from oes.csv_io import write_csv
from oes.dynamics.checkpoint import load_any_model as load_dynamics
from oes.episodes.capture import capture_split
from oes.evaluation.evaluate_forecasts import error_rows, mesh_geometry
from oes.evaluation.forecasters import RolloutsConfig, make_forecaster
from oes.meshes.build import MeshesConfig, ingest_folder
from oes.meshes.catalogue import load_catalogue
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.objects_file import ObjectStore, read_objects, write_objects
from oes.perception.observations import ObjectsConfig, ScenePerceiver, perceive_split
from oes.perception.perceiver import Perceiver
from oes.perception.solids import solids_of
from oes.record.dataset import FrameSource
from oes.report.aggregates import error_aggregates
from oes.report.provenance import describe_machine, provenance, read_seeds
from oes.report.rows import read_rows
from oes.report.table import markdown, write_group
from oes.report.tables import forecast_groups
from oes.schema import ERRORS
from oes.sim.simulate import EpisodesConfig, SplitConfig
from oes.stage import publish, work_dir

TASK, SPLIT = "pushing", "test2"


class EvaluateError(ValueError):
    """No mesh, or no episode, to evaluate on."""


@params
class EvaluateConfig:
    """The section ``evaluate``: how many two-object episodes are captured."""

    episodes: int


def main(cfg: EvaluateConfig, meshes: Path) -> None:
    """Ingest ``meshes``, capture, forecast, and write the table. Raises EvaluateError,
    CatalogueError.
    """
    perception, dynamics = find_weights((DATASETS, KEPT), ())
    out = Path("build") / f"evaluate-{meshes.resolve().name}"
    mesh_cfg, capture_cfg = (
        load(PARAMS, "meshes", MeshesConfig),
        load(PARAMS, "episodes", EpisodesConfig),
    )
    split = SplitConfig(count=cfg.episodes, min_objects=2, max_objects=2)
    capture_cfg = replace(capture_cfg, splits={**capture_cfg.splits, TASK: {SPLIT: split}})
    with work_dir(out, (mesh_cfg, capture_cfg, [meshes, perception, *dynamics.values()])) as work:
        if not (work / "meshes").exists():
            ingest_folder(meshes, mesh_cfg, work / "meshes")
        failures = capture_split(work / "meshes", capture_cfg, TASK, SPLIT, work / "episodes")
        if len(failures) == cfg.episodes:
            raise EvaluateError(
                f"{meshes}: no episode could be captured; the first: {failures[0].reason}"
            )
        store = perceive(work, perception, load(PARAMS, "objects", ObjectsConfig))
        (work / "report").mkdir(exist_ok=True)
        write_errors(work, store, dynamics, load(PARAMS, "rollouts", RolloutsConfig))
        sys.stdout.write(
            write_report(work / "report", f"meshes of {meshes.name}", cfg.episodes - len(failures))
        )
        publish(work / "report", out)
        shutil.rmtree(work)


def perceive(work: Path, perception: Path, cfg: ObjectsConfig) -> ObjectStore:
    """What perception sees in the captured episodes, under every test setting."""
    path = work / "objects.safetensors"
    if not path.exists():
        (work / "progress").mkdir(exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        catalogue, perceiver = load_catalogue(work / "meshes"), Perceiver.load(perception, device)
        gt_profiles = GroundTruthProfiles(catalogue, perceiver.net.cfg.surface.cylinder)
        solids = solids_of(catalogue, cfg.num_solid_points)
        observer = ScenePerceiver(
            cfg,
            cfg.settings(TASK, SPLIT),
            perceiver,
            FrameSource(work / "episodes"),
            gt_profiles,
            solids,
        )
        tensors, _, _ = perceive_split(observer, work / "progress")
        write_objects(path, tensors, list(observer.settings))
    return read_objects(path)


def write_errors(
    work: Path, store: ObjectStore, dynamics: Mapping[str, Path], cfg: RolloutsConfig
) -> None:
    """``report/errors.csv``: the errors of every model."""
    recorded = dict(enumerate(FrameSource(work / "episodes").episodes))
    catalogue = load_catalogue(work / "meshes")
    geometry = mesh_geometry(catalogue, cfg.num_surface_points)
    rows: list[dict[str, object]] = []
    for word, folder in dynamics.items():
        forecast = make_forecaster(load_dynamics(folder), catalogue, cfg)
        rows += error_rows(forecast, store, recorded, geometry, (TASK, word, SPLIT), cfg)
    write_csv(work / "report" / "errors.csv", rows, ERRORS)


def write_report(folder: Path, what: str, episodes: int) -> str:
    """Table 1 of the rows in ``folder``, written there as md, csv and tex; gives the Markdown."""
    frame = error_aggregates(read_rows([folder / "errors.csv"], ERRORS), seed=0)
    group = forecast_groups(frame, TASK)[0]
    write_group(group, folder)
    line = provenance(what, {"test": episodes}, read_seeds(PARAMS), describe_machine())
    text = "\n".join([*map(markdown, group.tables), *group.notes, "", line]) + "\n"
    (folder / f"{group.name}.md").write_text(text, encoding="utf-8")
    return text


if __name__ == "__main__":
    run(main)
