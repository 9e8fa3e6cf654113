"""trials: objects pushed to targets by model predictive control; one row a trial, with films of
some.
"""

import shutil
from pathlib import Path

from oes.cli import run
from oes.csv_io import write_csv
from oes.stage import publish, work_dir
from oes.trials.results import TRIAL_COLUMNS, trial_rows, write_videos
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
        progress = work / "progress"
        found = run_trials(cfg, scenario, inputs, progress)
        videos = write_videos(found, cfg.scenarios[scenario], cfg.film, cfg.num_videos, work)
        write_csv(
            work / "trials.csv",
            trial_rows(found, scenario, model, cfg.scenarios[scenario], videos),
            TRIAL_COLUMNS,
        )
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
