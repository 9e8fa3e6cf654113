"""Training the two baselines on clips, and what they have learned."""

from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from oes.baselines import BASELINES
from oes.baselines.clips import Clips, sample_clips
from oes.baselines.losses import Latent, foresight_loss, planet_loss
from oes.baselines.overhead_camera import OverheadView
from oes.baselines.planet import PlaNet, PlanetConfig
from oes.baselines.visual_foresight import ForesightConfig, VisualForesight
from oes.config import from_json, params, to_json
from oes.training.loop import TrainConfig, fit
from oes.training.tensor_io import read_tensors, write_tensors

BaselineModel = VisualForesight | PlaNet
BASELINE_FILE = "model.safetensors"
BASELINE_FORMAT = "oes-video-1"


class BaselineError(ValueError):
    """A model's word that does not exist, or a file that does not hold such a model."""


@params
class ForesightTraining:
    """How Visual Foresight is built and trained; a pixel that changes counts ``1 + changed``
    times.
    """

    net: ForesightConfig
    changed: float
    fit: TrainConfig


@params
class PlanetTraining:
    """How PlaNet is built and trained; ``weights`` of image, reward and kl."""

    net: PlanetConfig
    latent: Latent
    weights: dict[str, float]
    fit: TrainConfig


@params
class BaselinesConfig:
    """The section ``video``: one part per model."""

    visual_foresight: ForesightTraining
    planet: PlanetTraining


def train_baseline(
    cfg: BaselinesConfig, word: str, clips: Clips, work: Path, device: torch.device
) -> tuple[BaselineModel, list[dict[str, float]]]:
    """Train a model of ``BASELINES`` from scratch, or go on from the progress in ``work``. The
    model and its log.

    Raises VideoError for an unknown word.
    """
    if word not in BASELINES:
        raise BaselineError(f"unknown model {word!r}; there are: {', '.join(BASELINES)}")
    own = cfg.visual_foresight if word == "visual_foresight" else cfg.planet
    torch.manual_seed(own.fit.seed)

    def batch_at(step: int) -> Clips:
        return sample_clips(clips, own.fit.batch, np.random.default_rng([own.fit.seed, step]))

    if isinstance(own, ForesightTraining):
        model: BaselineModel = VisualForesight(own.net)
        loss, weights = foresight_loss(own.changed), {"picture": 1.0}
    else:
        model = PlaNet(own.net)
        loss, weights = planet_loss(own.latent, mean_picture(clips).to(device)), own.weights
    rows = fit(
        model,
        batch_at,
        lambda net, batch: loss(net, batch.to(device)),
        weights,
        own.fit,
        work,
        device,
    )
    return model, rows


def mean_picture(clips: Clips) -> Tensor:
    """The median picture of the first states, 3HW, 0 to 1: the empty table."""
    return clips.frame_BI3HW[:256, 0].float().median(0).values / 255


def save_baseline(folder: Path, model: BaselineModel, view: OverheadView) -> None:
    """Write a model of ``BASELINES`` with its config and its camera's; the file appears whole."""
    word = next(word for word, kind in BASELINES.items() if type(model) is kind)
    about = {
        "format": BASELINE_FORMAT,
        "model": word,
        "net": to_json(model.cfg),
        "view": to_json(view),
    }
    write_tensors(model.state_dict(), folder / BASELINE_FILE, about)


def is_baseline(folder: Path) -> bool:
    """Whether the weights in ``folder`` say that they are of a video model."""
    try:
        with safe_open(folder / BASELINE_FILE, framework="pt") as file:
            return (file.metadata() or {}).get("format") == BASELINE_FORMAT
    except (SafetensorError, OSError):
        return False


def load_baseline(folder: Path) -> tuple[BaselineModel, OverheadView]:
    """The model in ``folder`` (eval mode) and its camera. Raises VideoError naming the file and
    what is wrong.
    """
    path = folder / BASELINE_FILE
    tensors, about = read_tensors(path, BASELINE_FORMAT, BaselineError)
    if about.get("model") not in BASELINES:
        raise BaselineError(
            f"{path}: unknown model {about.get('model')!r}; there are: {', '.join(BASELINES)}"
        )
    model: BaselineModel
    if about["model"] == "planet":
        model = PlaNet(from_json(about["net"], PlanetConfig, f"{path}: net"))
    else:
        model = VisualForesight(from_json(about["net"], ForesightConfig, f"{path}: net"))
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        raise BaselineError(f"{path}: its weights do not fit its config: {error}") from error
    return model.eval().requires_grad_(False), from_json(
        about["view"], OverheadView, f"{path}: view"
    )
