"""baselines: a video-prediction model trained on overhead clips and evaluated on held-out ones."""

import shutil
from pathlib import Path

import cv2
import torch

from oes.baselines.clips import read_clips
from oes.baselines.evaluate import forecast_rows
from oes.baselines.train import BaselinesConfig, save_baseline, train_baseline
from oes.cli import run
from oes.csv_io import columns_of, write_csv
from oes.stage import publish, work_dir


def main(cfg: BaselinesConfig, model: str, overhead: Path, out: Path) -> None:
    """Write the weights, ``log.csv``, ``forecasts.csv`` and ``forecasts.png``."""
    with work_dir(out, (cfg, model, [overhead])) as work:
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        clips, view = read_clips(overhead / "pushing-train")
        net, log = train_baseline(cfg, model, clips, progress, device)
        held_out, _ = read_clips(overhead / "pushing-test2")
        rows, image = forecast_rows(net.cpu().eval(), held_out, view.half_m)
        save_baseline(work, net, view)
        write_csv(work / "log.csv", log, columns_of(log))
        write_csv(work / "forecasts.csv", rows, list(rows[0]))
        cv2.imwrite(str(work / "forecasts.png"), image[..., ::-1])
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
