"""Runs of trials with untrained networks: rows, videos, failures, resumption, determinism."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oes.config import load
from oes.csv_io import write_csv
from oes.report.rows import read_rows
from oes.schema import TRIALS
from oes.sim.pushing import PushWorld
from oes.trials.results import Trial, trial_rows, write_videos
from oes.trials.runner import ScenarioError, TrialInputs, TrialsConfig, run_trials
from tests.blocks import SMOKE, make_catalogue, make_weights


@pytest.fixture(scope="module")
def cfg() -> TrialsConfig:
    trials = load(SMOKE, "trials", TrialsConfig)
    targets = replace(trials.scenarios["targets"], max_steps=2)
    video = replace(trials.video, zoom=2, observation_s=0.2, plan_s=0.2, end_s=0.2)
    return replace(trials, num_trials=2, num_workers=1, scenarios={"targets": targets}, video=video)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> TrialInputs:
    folder = tmp_path_factory.mktemp("inputs")
    make_catalogue(folder / "meshes")
    make_weights(folder)
    perception = folder / "perception" / "perception.safetensors"
    return TrialInputs(folder / "meshes", perception, folder / "dynamics" / "pushing-graph_xyz")


@pytest.fixture(scope="module")
def progress(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("progress")


@pytest.fixture(scope="module")
def finished(cfg: TrialsConfig, inputs: TrialInputs, progress: Path) -> list[Trial]:
    return run_trials(cfg, "targets", inputs, progress)


def test_rows_and_videos_of_a_run(cfg: TrialsConfig, finished: list[Trial], tmp_path: Path) -> None:
    targets = cfg.scenarios["targets"]
    videos = write_videos(finished, targets, cfg.video, cfg.num_videos, tmp_path)
    write_csv(
        tmp_path / "trials.csv",
        trial_rows(finished, "targets", "graph_xyz", targets, videos),
        TRIALS,
    )
    rows = read_rows([tmp_path / "trials.csv"], TRIALS)
    assert rows["trial_i"].tolist() == [0, 1] * 2
    assert rows["planner"].tolist() == ["shooting"] * 2 + ["cem"] * 2
    assert set(rows["scenario"]) == {"targets"}
    assert (rows["initial_mm"] > 40).all() and np.isfinite(rows["mean_final_mm"]).all()
    assert (rows["failure"] == "").all() and (rows["steps_used"] <= 2).all()
    assert sum(name != "" for name in rows["video"]) >= 1
    for name in filter(None, rows["video"]):
        assert (tmp_path / name).stat().st_size > 1000 and (tmp_path / name).with_suffix(
            ".gif"
        ).exists()


def test_finished_trials_are_not_run_again(
    cfg: TrialsConfig,
    inputs: TrialInputs,
    progress: Path,
    finished: list[Trial],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(PushWorld, "push", lambda *_: pytest.fail("a finished trial runs again"))
    again = run_trials(cfg, "targets", inputs, progress)
    for old, new in zip(finished, again, strict=True):
        assert (old.planner, old.trial_i, old.failure) == (new.planner, new.trial_i, new.failure)
        assert old.result and new.result and np.array_equal(old.result.final_G, new.result.final_G)


def test_a_second_run_gives_the_same_trials(
    cfg: TrialsConfig, inputs: TrialInputs, finished: list[Trial], tmp_path: Path
) -> None:
    repeated = run_trials(replace(cfg, num_trials=1), "targets", inputs, tmp_path)
    first, again = finished[0], repeated[0]
    assert first.task and again.task and first.result and again.result
    assert np.array_equal(first.task.goal_G3, again.task.goal_G3)
    assert np.array_equal(first.result.final_G, again.result.final_G)
    assert np.array_equal(first.result.steps[-1].rgb_HW3, again.result.steps[-1].rgb_HW3)


@pytest.mark.parametrize("model", ["visual_foresight", "planet"])
def test_image_based_models_plan(
    cfg: TrialsConfig, inputs: TrialInputs, finished: list[Trial], model: str, tmp_path: Path
) -> None:
    model_inputs = replace(inputs, dynamics=inputs.dynamics.with_name(f"pushing-{model}"))
    trials = run_trials(replace(cfg, num_trials=1), "targets", model_inputs, tmp_path)
    assert [trial.planner for trial in trials] == ["shooting", "cem"]
    for trial in trials:
        assert trial.result and trial.failure == "" and finished[0].task and trial.task
        assert np.array_equal(trial.task.goal_G3, finished[0].task.goal_G3)
        assert sum(record.plan is not None for record in trial.result.steps) == 2
        assert trial.result.steps[0].estimate.overhead_HW3 is not None


def test_a_trial_without_a_task_has_a_row_with_the_reason(
    cfg: TrialsConfig, inputs: TrialInputs, tmp_path: Path
) -> None:
    targets = replace(cfg.scenarios["targets"], goal_distance_m=(5.0, 6.0), max_attempts=3)
    impossible = replace(cfg, num_trials=1, scenarios={"targets": targets})
    trials = run_trials(impossible, "targets", inputs, tmp_path / "progress")
    assert write_videos(trials, targets, cfg.video, cfg.num_videos, tmp_path) == {}
    write_csv(tmp_path / "trials.csv", trial_rows(trials, "targets", "oes", targets, {}), TRIALS)
    with (tmp_path / "trials.csv").open() as file:
        (row, _) = csv.DictReader(file)
    assert row["success"] == "False" and row["mean_final_mm"] == "nan"
    assert "no task in 3 attempts" in row["failure"]


def test_an_unknown_scenario_is_rejected_with_the_valid_names(
    cfg: TrialsConfig, inputs: TrialInputs, tmp_path: Path
) -> None:
    with pytest.raises(ScenarioError, match=r"unknown scenario 'fly'.*targets"):
        run_trials(cfg, "fly", inputs, tmp_path)
