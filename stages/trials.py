"""trials: objects pushed to goals by model predictive control; one row per trial, some videos."""

import shutil
from pathlib import Path

from oes.cli import run
from oes.csv_io import write_csv
from oes.schema import TRIALS
from oes.stage import publish, work_dir
from oes.trials.results import trial_rows, write_videos
from oes.trials.runner import TrialInputs, TrialsConfig, run_trials


def main(
    cfg: TrialsConfig,
    scenario: str,
    model: str,
    meshes: Path,
    perception: Path,
    dynamics: Path,
    out: Path,
) -> None:
    """Write trials.csv and the videos. ``dynamics`` is the folder of ``model``'s weights."""
    inputs = TrialInputs(meshes, perception / "perception.safetensors", dynamics)
    with work_dir(out, (cfg, scenario, model, [meshes, perception, dynamics])) as work:
        progress, own = work / "progress", cfg.scenarios[scenario]
        trials = run_trials(cfg, scenario, inputs, progress)
        videos = write_videos(trials, own, cfg.video, cfg.num_videos, work)
        rows = trial_rows(trials, scenario, model, own, videos)
        write_csv(work / "trials.csv", rows, TRIALS)
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
