"""A small, complete, synthetic set of the outputs that the report reads."""

import json
from itertools import product
from pathlib import Path

import numpy as np
from PIL import Image
from safetensors.numpy import save_file

from oes.csv_io import write_csv
from oes.report.inputs import Inputs
from oes.report.names import SETTINGS
from oes.schema import (
    BOX,
    DETECTIONS,
    ERRORS,
    FORECASTS,
    FUTURES,
    IMAGE_MODELS,
    MODEL_LABELS,
    TRIALS,
    VIEWS,
)
from oes.viz.video import write_gif, write_video

MORE_VIEWS = ("2views_pred", "3views_pred", "5views_pred")
SCENES = {  # number of objects, split and setting
    "pushing": [
        *((2, "test2", setting) for setting in (*SETTINGS, *MORE_VIEWS)),
        *((n, f"test{n}", "1view_pred") for n in (1, 3, 4, 5)),
    ],
    "falling": [
        *((n, f"test{n}", setting) for n in (3, 4) for setting in ("1view_gt", "1view_pred")),
        *((n, f"test{n}", "1view_pred") for n in (1, 2, 5)),
    ],
}
TILE_PX = 25
UNCALIBRATED = dict.fromkeys(("sigma_mm", "within_50", "within_90", "nll", "nll_homoscedastic"))
"""Columns of models without an error model."""


def make_inputs(root: Path) -> Inputs:
    """The datasets of all stages under ``root``, of both tasks."""
    names = (
        "meshes",
        "episodes",
        "perception",
        "objects",
        "dynamics",
        "rollouts",
        "futures",
        "trials",
    )
    found = Inputs(**{name: root / name for name in names})
    for task in SCENES:
        write_errors(found.rollouts, task)
        write_card(found.episodes / f"{task}-train", task)
        for model in ("oes", "graph_xyz"):
            write_strips(found.rollouts / f"{task}-{model}" / "scenes", num_scenes=2)
    for name in ("pushing-test2", "falling-test3", "falling-test4"):
        write_perception(found.objects / name)
    for task in SCENES:
        write_futures(found.futures / task)
    write_trials(found.trials)
    for folder in (found.meshes, found.perception, found.dynamics / "pushing-oes"):
        folder.mkdir(parents=True)
    write_image(found.meshes / "contact_sheet.png")
    about = {"format": "f", "config": "{}", "a": "1", "z": "2"}
    weights = {"w": np.linspace(-1, 1, 9, dtype=np.float32), "n": np.array([3], np.int64)}
    save_file(weights, found.perception / "perception.safetensors", about)
    save_file(weights, found.dynamics / "pushing-oes" / "model.safetensors", about)
    (found.perception / "log.csv").write_text(
        "step,loss,val_ap_50,val_psnr_db\n50,9.0,,\n100,5.0,0.5,20.0\n"
    )
    (found.dynamics / "pushing-oes" / "log.csv").write_text(
        "step,loss,mm_5,deg_5\n100,2.0,,\n200,1.0,30.0,20.0\n"
    )
    write_forecasts(found.dynamics / "pushing-planet")
    return found


def write_futures(folder: Path) -> None:
    """Two episodes: 3D-OES is better than graph-XYZ by a factor, and its error grows with T."""
    (folder / "gallery").mkdir(parents=True)
    rows: dict[str, list[dict[str, object]]] = {name: [] for name in FUTURES}
    for episode_i, T, (size, word) in product(
        (0, 1), (1, 3, 5), enumerate(("oes", "graph_xyz"), start=1)
    ):
        about = {"task": folder.name, "episode_i": episode_i, "T": T}
        quality = {"psnr_db": 20.0 + episode_i, "ssim": 0.8, "feature_error": 0.1 * T * size}
        on_objects = {"objects_psnr_db": 15.0 if episode_i else ""}
        rows["renders"].append(about | {"source": word} | quality | on_objects)
        found = {"object_i": 0, "views_found": 2 + episode_i, "centre_mm": 9.0, "spread_mm": ""}
        rows["consistency"].append(about | {"source": word} | found)
        error = {"translation_mm": 2.0 * T * size, "rotation_deg": T * size}
        row = about | {"model": word, "object_i": 0, "detected": 1} | error
        rows["edits"] += [row | {"edit": kind} for kind in ("none", "move")]
    for name, columns in FUTURES.items():
        write_csv(folder / f"{name}.csv", rows[name], columns)
    for name in ("forecast-000000.png", "views-000000.png", "edits-000000.png"):
        write_image(folder / "gallery" / name)
    write_film(folder / "gallery" / "views-000000.mp4")


def write_image(path: Path) -> None:
    Image.fromarray(np.full((40, 1600, 3), 90, np.uint8)).save(path)


def write_film(path: Path) -> None:
    """Three frames of 64 by 48 pixels at 5 frames a second."""
    write_video(np.full((3, 48, 64, 3), 90, np.uint8), path, 5)


def write_forecasts(folder: Path) -> None:
    """Two clips of a model that forecasts pictures."""
    folder.mkdir(parents=True)
    rows = [
        dict(zip(FORECASTS, (clip, T, 20 + clip, 0.8, 18.0, 0.7, 30.0, 50.0), strict=True))
        for clip, T in ((0, 1), (1, 1))
    ]
    write_csv(folder / "forecasts.csv", rows, list(FORECASTS))
    write_image(folder / "forecasts.png")


def write_errors(folder: Path, task: str) -> None:
    """Errors that grow with the model's place in the order, the number of objects, and fall with
    views.

    Of pushing, two ablations too, with the errors of Contact.
    """
    rng = np.random.default_rng(0)
    for size, model in enumerate(
        (name for name in MODEL_LABELS if name not in IMAGE_MODELS), start=1
    ):
        rows = []
        for num_objects, split, setting in SCENES[task]:
            num_views = int(setting[0]) if setting[0].isdigit() else 1
            for episode_i, object_i, T in np.ndindex(4, num_objects, 5):
                error = size * (T + 1) * num_objects / num_views * rng.uniform(0.9, 1.1)
                place = (
                    task,
                    model,
                    setting,
                    split,
                    episode_i,
                    object_i,
                    num_objects,
                    num_views,
                    T + 1,
                )
                sure = (error, int(T % 2), 1, 3.0, 3.5) if model == "contact" else ("",) * 5
                values = (*place, error, error / 2, error / 4, 1, 1, 0.5 * (T % 2), *sure)
                rows.append(dict(zip(ERRORS, values, strict=True)))
        (folder / f"{task}-{model}").mkdir(parents=True)
        write_csv(folder / f"{task}-{model}" / "errors.csv", rows, list(ERRORS))
        for variant in (
            ("contact_gt", "contact_300") if (task, model) == ("pushing", "contact") else ()
        ):
            (folder / f"{task}-{variant}").mkdir()
            varied = [row | {"model": variant} for row in rows if row["setting"] == "1view_pred"]
            write_csv(folder / f"{task}-{variant}" / "errors.csv", varied, list(ERRORS))


def write_card(folder: Path, task: str) -> None:
    folder.mkdir(parents=True)
    cause = {"pushing": {"rod_rms_mm": {"mean": 1.5}}, "falling": {"impact": {"1": 0.25, "5": 1.0}}}
    card = {
        "episodes": 12,
        "displacement_mm": {str(T): {"mean": 10.0 * T} for T in (1, 3, 5)},
        "displacements_mm": {str(T): [5.0 * T, 15.0 * T] for T in (1, 3, 5)},
        "share_object_contact": 0.4,
        "share_moved": 0.9,
    }
    (folder / "card.json").write_text(json.dumps(card | cause[task]))


def write_strips(folder: Path, num_scenes: int) -> None:
    """Pictures of scenes over T = 0 to 5: every tile of one brightness, the forecast's brighter
    than the truth's.
    """
    folder.mkdir(parents=True)
    for scene_i in range(num_scenes):
        levels = 40 + 20 * np.arange(6) + np.array([[0], [100]])
        picture = (
            levels.repeat(TILE_PX, axis=0).repeat(TILE_PX, axis=1)[..., None].repeat(3, axis=2)
        )
        Image.fromarray(picture.astype(np.uint8)).save(folder / f"test2-{scene_i:06d}.png")


def write_perception(folder: Path) -> None:
    """Two true objects in each of two states: one found exactly, one missed; one false box with a
    low score.
    """
    folder.mkdir(parents=True)
    rows = []
    for num_views in (1, 3):
        for episode in (0, 1):
            base = {"episode": episode, "step": 0, "num_views": num_views}
            box = dict(zip(BOX, (0.1, 0, 0.02, 0.05, 0.05, 0.04), strict=True))
            true = {f"true_{name}": value for name, value in box.items()}
            rows.append(
                base | box | true | {"score": 0.9, "iou": 1.0, "centre_mm": 0.0, "mask_iou": 0.8}
            )
            rows.append(base | true | {"true_x_m": -0.1})
            rows.append(base | box | {"x_m": 0.25, "score": 0.3})
    write_csv(folder / "detections.csv", rows, list(DETECTIONS))
    about = {"episode": 0, "step": 0, "camera": 3, "ssim": 0.8}
    views = [about | {"num_views": n, "psnr_db": 20 + n + i} for n in (1, 3) for i in (0, 1)]
    write_csv(folder / "views.csv", views, VIEWS)


def write_trials(folder: Path) -> None:
    for model, wins in (("oes", 5), ("graph_xyz", 3), ("graph_xyz_image", 2)):
        (folder / f"targets-{model}").mkdir(parents=True)
        rows = []
        for i in range(6):
            video = f"trial_{i:03d}.mp4" if i in (0, 5) else ""
            end_mm = 20.0 if i < wins else 90.0
            values = (
                "targets",
                model,
                "shooting",
                30,
                1,
                i,
                1,
                i < wins,
                i < wins,
                False,
                150.0,
                end_mm,
                21.0,
                6,
                "",
                video,
            )
            rows.append(dict(zip(TRIALS, values, strict=True)))
            if video:
                write_film(path := folder / f"targets-{model}" / video)
                write_gif([(np.zeros((48, 64, 3), np.uint8), 0.2)], path.with_suffix(".gif"))
        write_csv(folder / f"targets-{model}" / "trials.csv", rows, list(TRIALS))
