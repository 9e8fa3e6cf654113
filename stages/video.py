"""video: a baseline that forecasts pictures, trained on the frames of the training episodes and tried on others'."""

import shutil
from pathlib import Path

import cv2
import torch

from oes.rows import columns_of, write_csv
from oes.stage import publish, run, work_dir
from oes.video.check import forecast_rows
from oes.video.clips import read_clips
from oes.video.train import Video, save_video_model, train


def main(cfg: Video, model: str, frames: Path, out: Path) -> None:
    """Write the weights, ``log.csv``, ``forecasts.csv`` and ``forecasts.png``."""
    with work_dir(out, (cfg, model, [frames])) as work:
        progress = work / "progress"
        progress.mkdir(exist_ok=True)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        clips, view = read_clips(frames / "pushing-train" / "frames.safetensors")
        net, log = train(cfg, model, clips, progress, device)
        unseen, _ = read_clips(frames / "pushing-test2" / "frames.safetensors")
        rows, picture = forecast_rows(net.cpu().eval(), unseen, view)
        save_video_model(work, net, view)
        write_csv(work / "log.csv", log, columns_of(log))
        write_csv(work / "forecasts.csv", rows, list(rows[0]))
        cv2.imwrite(str(work / "forecasts.png"), picture[..., ::-1])
        shutil.rmtree(progress)
        publish(work, out)


if __name__ == "__main__":
    run(main)
