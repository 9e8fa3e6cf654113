"""The trained models on your meshes: ingest, capture of two-object episodes, forecasts, Table 1.

``python -m oes.apps.evaluate --meshes FOLDER`` trains nothing. It prints a report and writes it
with all raw rows to build/evaluate-<folder>-<episodes>/.
"""

import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import pandas as pd
import torch

from oes import schema
from oes.apps.assets import DATASETS, KEPT, find_weights
from oes.cli import run
from oes.config import PARAMS, load, params
from oes.csv_io import write_csv
from oes.dynamics.checkpoint import load_any_model
from oes.episodes.capture import capture_split
from oes.evaluation.evaluate_forecasts import error_rows, mesh_geometry
from oes.evaluation.forecasters import RolloutsConfig, make_forecaster
from oes.meshes.build import MeshesConfig, ingest_folder
from oes.meshes.catalogue import load_catalogue
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.objects_file import read_objects, write_objects
from oes.perception.observations import ObjectsConfig, ScenePerceiver, perceive_split
from oes.perception.perceiver import Perceiver
from oes.perception.solids import solids_of
from oes.progress import progress_bar
from oes.record.dataset import FrameSource
from oes.report.aggregates import detector_aggregates, error_aggregates, tidy, view_prediction
from oes.report.inputs import read_detections
from oes.report.provenance import describe_machine, provenance, read_seeds
from oes.report.rows import read_rows
from oes.report.table import markdown, write_group
from oes.report.tables import all_groups
from oes.sim.simulate import EpisodesConfig, SplitConfig
from oes.stage import publish, work_dir

TASK, SPLIT = "pushing", "test2"


class EvaluateError(ValueError):
    """No mesh, or no episode, to evaluate on."""


@params
class EvaluateConfig:
    """The section ``evaluate``: number of two-object episodes, unless a flag gives another."""

    episodes: int


def main(
    cfg: EvaluateConfig,
    meshes: Annotated[Path, "folder of OBJ, STL, PLY or GLB files"],
    episodes: Annotated[int, "two-object episodes to capture; 0: evaluate.episodes"] = 0,
    keep_episodes: Annotated[bool, "keep the captured episodes"] = False,
) -> None:
    """Evaluate all trained models. Raises EvaluateError, CatalogueError, WeightsMissing."""
    count = episodes or cfg.episodes
    perception, dynamics = find_weights((DATASETS, KEPT), ())
    out = Path("build") / f"evaluate-{meshes.resolve().name}-{count}"
    mesh_cfg = load(PARAMS, "meshes", MeshesConfig)
    capture_cfg = load(PARAMS, "episodes", EpisodesConfig)
    split = SplitConfig(count=count, min_objects=2, max_objects=2)
    capture_cfg = replace(capture_cfg, splits={**capture_cfg.splits, TASK: {SPLIT: split}})
    inputs = [meshes, perception, *dynamics.values()]
    with work_dir(out, (mesh_cfg, capture_cfg, inputs)) as work:
        if not (work / "meshes").exists():
            ingest_folder(meshes, mesh_cfg, work / "meshes")
        failures = capture_split(work / "meshes", capture_cfg, TASK, SPLIT, work / "episodes")
        if len(failures) == count:
            raise EvaluateError(f"{meshes}: no episode was captured; first: {failures[0].reason}")
        report = work / "report"
        report.mkdir(exist_ok=True)
        write_perception(work, perception, load(PARAMS, "objects", ObjectsConfig))
        write_errors(work, dynamics, load(PARAMS, "rollouts", RolloutsConfig))
        for name, kept in (("catalogue", "accepted"), ("rejected", "rejected")):
            shutil.copyfile(work / "meshes" / f"{name}.csv", report / f"{kept}.csv")
        if keep_episodes:
            shutil.copytree(work / "episodes", report / "episodes", dirs_exist_ok=True)
        sys.stdout.write(write_report(report, f"meshes of {meshes.name}", count - len(failures)))
        publish(report, out)


def write_perception(work: Path, weights: Path, cfg: ObjectsConfig) -> None:
    """``objects.safetensors`` of all test settings; ``report/detections.csv`` and ``views.csv``."""
    path = work / "objects.safetensors"
    if path.exists():
        return
    (work / "progress").mkdir(exist_ok=True)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    catalogue, perceiver = load_catalogue(work / "meshes"), Perceiver.load(weights, device)
    profiles = GroundTruthProfiles(catalogue, perceiver.net.cfg.surface.cylinder)
    solids = solids_of(catalogue, cfg.num_solid_points)
    source, settings = FrameSource(work / "episodes"), cfg.settings(TASK, SPLIT)
    scenes = ScenePerceiver(cfg, settings, perceiver, source, profiles, solids)
    tensors, detections, views = perceive_split(scenes, work / "progress")
    write_csv(work / "report/detections.csv", detections, schema.DETECTIONS)
    write_csv(work / "report/views.csv", views, schema.VIEWS)
    write_objects(path, tensors, list(settings))


def write_errors(work: Path, dynamics: Mapping[str, Path], cfg: RolloutsConfig) -> None:
    """``report/errors.csv``: the errors of every model."""
    store = read_objects(work / "objects.safetensors")
    recorded = dict(enumerate(FrameSource(work / "episodes").episodes))
    catalogue = load_catalogue(work / "meshes")
    geometry = mesh_geometry(catalogue, cfg.num_surface_points)
    rows: list[dict[str, object]] = []
    for name, folder in progress_bar(
        dynamics.items(), total=len(dynamics), desc="forecasting", unit="model"
    ):
        forecaster = make_forecaster(load_any_model(folder), catalogue, cfg)
        rows += error_rows(forecaster, store, recorded, geometry, (TASK, name, SPLIT), cfg)
    write_csv(work / "report/errors.csv", rows, schema.ERRORS)


def write_report(folder: Path, profile: str, episodes: int) -> str:
    """Tables of the rows in ``folder`` as md, csv and tex; returns the Markdown."""
    errors = error_aggregates(read_rows([folder / "errors.csv"], schema.ERRORS), seed=0)
    detections = detector_aggregates(read_detections([folder / "detections.csv"]), TASK)
    views = view_prediction(read_rows([folder / "views.csv"], schema.VIEWS))
    frame = pd.concat([errors, tidy([*detections, *views])], ignore_index=True)
    counts = {name: len(pd.read_csv(folder / f"{name}.csv")) for name in ("accepted", "rejected")}
    seeds = read_seeds(PARAMS)
    parts = [
        provenance(profile, {"test": episodes}, seeds, describe_machine()),
        f"{counts['accepted']} meshes accepted (accepted.csv), {counts['rejected']} rejected, "
        "each with its reason (rejected.csv).",
    ]
    for group in all_groups(frame).values():
        write_group(group, folder)
        parts += [f"## {group.title}", *map(markdown, group.tables), *group.notes]
    text = "\n\n".join(part.rstrip() for part in parts) + "\n"
    (folder / "report.md").write_text(text, encoding="utf-8")
    return text


if __name__ == "__main__":
    run(main)
