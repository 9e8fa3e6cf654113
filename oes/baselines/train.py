"""Training, saving and loading of the two baselines."""

from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from oes.baselines import BASELINES
from oes.baselines.clips import Clips, sample_clips
from oes.baselines.losses import PlanetLossConfig, foresight_loss, planet_loss
from oes.baselines.overhead_camera import OverheadView
from oes.baselines.planet import PlaNet, PlanetConfig
from oes.baselines.visual_foresight import ForesightConfig, VisualForesight
from oes.config import from_json, params, to_json
from oes.training.loop import TrainConfig, fit
from oes.training.tensor_io import read_tensors, write_tensors

BaselineModel = VisualForesight | PlaNet
BASELINE_FILE = "model.safetensors"
BASELINE_FORMAT = "oes-baseline-1"
NUM_BACKGROUND = 256  # images of which the background is the median


class BaselineError(ValueError):
    """An unknown model name, or a file that does not hold a baseline."""


@params
class ForesightTraining:
    """Visual Foresight; a pixel that changes counts ``1 + changed_pixel_weight`` times."""

    net: ForesightConfig
    changed_pixel_weight: float
    fit: TrainConfig


@params
class PlanetTraining:
    """PlaNet; ``weights`` of the loss terms image, reward and kl."""

    net: PlanetConfig
    loss: PlanetLossConfig
    weights: dict[str, float]
    fit: TrainConfig


@params
class BaselinesConfig:
    """The section ``baselines``: one part per model."""

    visual_foresight: ForesightTraining
    planet: PlanetTraining


def train_baseline(
    cfg: BaselinesConfig, name: str, clips: Clips, work: Path, device: torch.device
) -> tuple[BaselineModel, list[dict[str, float]]]:
    """Train a model of ``BASELINES`` or resume from ``work``; returns it and the rows of its log.

    Raises BaselineError for an unknown name.
    """
    _check_name(name)
    model_cfg = cfg.visual_foresight if name == "visual_foresight" else cfg.planet
    fit_cfg = model_cfg.fit
    torch.manual_seed(fit_cfg.seed)
    if isinstance(model_cfg, ForesightTraining):
        model: BaselineModel = VisualForesight(model_cfg.net)
        loss, weights = foresight_loss(model_cfg.changed_pixel_weight), {"image": 1.0}
    else:
        model = PlaNet(model_cfg.net)
        loss, weights = planet_loss(model_cfg.loss, background(clips).to(device)), model_cfg.weights

    def batch_at(step: int) -> Clips:
        return sample_clips(clips, fit_cfg.batch, np.random.default_rng([fit_cfg.seed, step]))

    def device_loss(net: torch.nn.Module, batch: Clips) -> dict[str, Tensor]:
        return loss(net, batch.to(device))

    return model, fit(model, batch_at, device_loss, weights, fit_cfg, work, device)


def background(clips: Clips) -> Tensor:
    """Median of the first images, 3HW from 0 to 1: the empty table."""
    return clips.frame_BI3HW[:NUM_BACKGROUND, 0].float().median(0).values / 255


def save_baseline(folder: Path, model: BaselineModel, view: OverheadView) -> None:
    """Write weights, configuration and camera of a model; the file appears whole."""
    metadata = {
        "format": BASELINE_FORMAT,
        "model": next(name for name, kind in BASELINES.items() if type(model) is kind),
        "net": to_json(model.cfg),
        "view": to_json(view),
    }
    write_tensors(model.state_dict(), folder / BASELINE_FILE, metadata)


def is_baseline(folder: Path) -> bool:
    """Whether the model file in ``folder`` holds a baseline."""
    try:
        with safe_open(folder / BASELINE_FILE, framework="pt") as file:
            return (file.metadata() or {}).get("format") == BASELINE_FORMAT
    except (SafetensorError, OSError):
        return False


def load_baseline(folder: Path) -> tuple[BaselineModel, OverheadView]:
    """The model in ``folder`` (eval mode) and its camera. Raises BaselineError naming the file."""
    path = folder / BASELINE_FILE
    tensors, metadata = read_tensors(path, BASELINE_FORMAT, BaselineError)
    _check_name(metadata.get("model", ""), f"{path}: ")
    model: BaselineModel
    if metadata["model"] == "planet":
        model = PlaNet(from_json(metadata["net"], PlanetConfig, f"{path}: net"))
    else:
        model = VisualForesight(from_json(metadata["net"], ForesightConfig, f"{path}: net"))
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        raise BaselineError(f"{path}: its weights do not fit its config: {error}") from error
    view = from_json(metadata["view"], OverheadView, f"{path}: view")
    return model.eval().requires_grad_(False), view


def _check_name(name: str, source: str = "") -> None:
    if name not in BASELINES:
        raise BaselineError(f"{source}unknown model {name!r}; valid: {', '.join(BASELINES)}")
