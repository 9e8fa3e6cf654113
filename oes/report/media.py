"""Images, films and weights of the stages, copied to the report at modest size."""

import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

import av
import numpy as np
import pandas as pd
from PIL import Image

from oes.episode import Pixels
from oes.report.figures import Media
from oes.report.inputs import Inputs, TablesConfig
from oes.report.names import OURS, SCENARIOS, label
from oes.schema import IMAGE_MODELS, VARIANT_LABELS
from oes.training.compact_weights import write_compact
from oes.viz.video import write_video

LARGE_BYTES = 500_000
PHOTO_WIDTH_PX, PHOTO_QUALITY = 1200, 75
FILM_WIDTH_PX = 480
GALLERY = {
    "forecast": "recorded motion, and the futures that 3D-OES and graph-XYZ forecast, from the "
    "input camera",
    "views": "recorded motion, and the future that 3D-OES forecasts, from three cameras",
    "prediction": "unseen views, predicted from one and from three input views",
    "edits": "edited scenes: simulated by Bullet, and forecast by 3D-OES",
}


def copy_images(inputs: Inputs, tasks: Iterable[str], out: Path) -> list[Media]:
    """The mesh sheet, the galleries of futures and the image forecasts, as WebP."""
    folder = out / "figures"
    found = [
        (inputs.meshes / "contact_sheet.png", "data", "meshes", "All meshes of the catalogue.")
    ]
    for model in IMAGE_MODELS:
        source = inputs.dynamics / f"pushing-{model}" / "forecasts.png"
        caption = f"{label(model)}: recorded clips above, forecast images below."
        found.append((source, "perception", f"forecasts-{model.replace('_', '-')}", caption))
    for task in tasks:
        for path in sorted((inputs.futures / task / "gallery").glob("*.png")):
            caption = f"{task.capitalize()}: {GALLERY[path.stem.split('-')[0]]}."
            found.append((path, "futures", f"{task}-{path.stem}", caption))
    media = []
    for source, page, name, caption in found:
        if source.exists() or page != "perception":
            write_photo(source, folder / f"{name}.webp")
            media.append(Media(page, f"figures/{name}.webp", caption))
    return media


def copy_films(inputs: Inputs, trials: pd.DataFrame, cfg: TablesConfig, out: Path) -> list[Media]:
    """Films of futures from three cameras, and of 3D-OES's shortest success and failure in each
    scenario, as small MP4; ``films/push.gif`` shows that success around an obstacle.
    """
    folder, media = out / "films", []
    for task in cfg.tasks:
        for source in sorted((inputs.futures / task / "gallery").glob("*.mp4")):
            caption = f"{task.capitalize()}: {GALLERY[source.stem.split('-')[0]]}."
            write_film(source, folder / f"{task}-{source.name}")
            media.append(Media("futures", f"films/{task}-{source.name}", caption))
    for scenario in cfg.scenarios:
        own = trials[(trials["scenario"] == scenario) & (trials["model"] == OURS)]
        for is_success in (True, False):
            filmed = own[(own["success"] == is_success) & (own["video"] != "")]
            for row in filmed.sort_values("steps_used", kind="stable")[:1].itertuples():
                source = inputs.trials / f"{scenario}-{OURS}" / str(row.video)
                target = folder / f"{scenario}-{source.name}"
                write_film(source, target)
                result = "success" if is_success else "failure"
                caption = f"Pushing {SCENARIOS.get(scenario, scenario)} with {label(OURS)} "
                caption += f"(planner {row.planner}, trial {row.trial_i}): {result}."
                media.append(Media("mpc", f"films/{target.name}", caption))
                if is_success and (scenario == "obstacle" or not (folder / "push.gif").exists()):
                    shutil.copyfile(source.with_suffix(".gif"), folder / "push.gif")
    return media


def write_photo(source: Path, target: Path) -> None:
    """A photograph as WebP, at most ``PHOTO_WIDTH_PX`` wide."""
    target.parent.mkdir(parents=True, exist_ok=True)
    image = Image.open(source).convert("RGB")
    image.thumbnail((PHOTO_WIDTH_PX, 10 * PHOTO_WIDTH_PX))
    image.save(target, quality=PHOTO_QUALITY, method=6)


def write_film(source: Path, target: Path) -> None:
    """A film as MP4, at most ``FILM_WIDTH_PX`` wide."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(source)) as container:
        fps = container.streams.video[0].average_rate
        frames = [
            _film_size(frame.to_ndarray(format="rgb24").astype(np.uint8))
            for frame in container.decode(video=0)
        ]
    write_video(frames, target, round(fps or 1))


def _film_size(pixels: Pixels) -> Pixels:
    image = Image.fromarray(pixels)
    scale = min(1, FILM_WIDTH_PX / image.width)
    width, height = (int(length * scale) // 2 * 2 for length in image.size)
    return np.asarray(image.resize((width, height), Image.Resampling.LANCZOS))


def copy_models(perception: Path, dynamics: Path, folder: Path) -> None:
    """``perception/`` and ``dynamics/<task>-<model>/`` without ablations; large files compact.

    Raises FileNotFoundError if there is no dynamics model.
    """
    name = "perception.safetensors"
    write_compact(perception / name, folder / "perception" / name)
    models = list(_models(dynamics))
    if not models:
        raise FileNotFoundError(f"{dynamics}: holds no model.safetensors in any folder")
    for source in models:
        target = folder / "dynamics" / source.parent.name / source.name
        target.parent.mkdir(parents=True, exist_ok=True)
        (write_compact if source.stat().st_size > LARGE_BYTES else shutil.copyfile)(source, target)


def _models(dynamics: Path) -> Iterator[Path]:
    for path in sorted(dynamics.glob("*/model.safetensors")):
        if path.parent.name.partition("-")[2] not in VARIANT_LABELS:
            yield path
