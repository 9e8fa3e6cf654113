"""Training the two baselines on clips, and what they have learned."""

from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from oes.config import from_json, params, to_json
from oes.fit import Fit, fit
from oes.video import VIDEO_MODELS
from oes.video.clips import Clips, draw
from oes.video.foresight import ForesightNet, VisualForesight
from oes.video.losses import Latent, foresight_loss, planet_loss
from oes.video.overhead import OverheadView
from oes.video.planet import PlaNet, PlanetNet
from oes.weights import read_tensors, write_tensors

VideoModel = VisualForesight | PlaNet
FILE = "model.safetensors"
FORMAT = "oes-video-1"


class VideoError(ValueError):
    """A model's word that does not exist, or a file that does not hold such a model."""


@params
class Foresight:
    """How Visual Foresight is built and trained; a pixel that changes counts ``1 + changed`` times."""

    net: ForesightNet
    changed: float
    fit: Fit


@params
class Planet:
    """How PlaNet is built and trained; ``weights`` of image, reward and kl."""

    net: PlanetNet
    latent: Latent
    weights: dict[str, float]
    fit: Fit


@params
class Video:
    """The section ``video``: one part per model."""

    visual_foresight: Foresight
    planet: Planet


def train(
    cfg: Video, word: str, clips: Clips, work: Path, device: torch.device
) -> tuple[VideoModel, list[dict[str, float]]]:
    """Train a model of ``VIDEO_MODELS`` from scratch, or go on from the progress in ``work``. The model and its log.

    Raises VideoError for an unknown word.
    """
    if word not in VIDEO_MODELS:
        raise VideoError(f"unknown model {word!r}; there are: {', '.join(VIDEO_MODELS)}")
    own = cfg.visual_foresight if word == "visual_foresight" else cfg.planet
    torch.manual_seed(own.fit.seed)

    def batch_at(step: int) -> Clips:
        return draw(clips, own.fit.batch, np.random.default_rng([own.fit.seed, step]))

    if isinstance(own, Foresight):
        model: VideoModel = VisualForesight(own.net)
        loss, weights = foresight_loss(own.changed), {"picture": 1.0}
    else:
        model = PlaNet(own.net)
        loss, weights = planet_loss(own.latent, mean_picture(clips).to(device)), own.weights
    rows = fit(model, batch_at, lambda net, batch: loss(net, batch.to(device)), weights, own.fit, work, device)
    return model, rows


def mean_picture(clips: Clips) -> Tensor:
    """The median picture of the first states, 3HW, 0 to 1: the empty table."""
    return clips.frame_BI3HW[:256, 0].float().median(0).values / 255


def save_video_model(folder: Path, model: VideoModel, view: OverheadView) -> None:
    """Write a model of ``VIDEO_MODELS`` with its config and its camera's; the file appears whole."""
    word = next(word for word, kind in VIDEO_MODELS.items() if type(model) is kind)
    about = {"format": FORMAT, "model": word, "net": to_json(model.cfg), "view": to_json(view)}
    write_tensors(model.state_dict(), folder / FILE, about)


def is_video_model(folder: Path) -> bool:
    """Whether the weights in ``folder`` say that they are of a video model."""
    try:
        with safe_open(folder / FILE, framework="pt") as file:
            return (file.metadata() or {}).get("format") == FORMAT
    except (SafetensorError, OSError):
        return False


def load_video_model(folder: Path) -> tuple[VideoModel, OverheadView]:
    """The model in ``folder`` (eval mode) and its camera. Raises VideoError naming the file and what is wrong."""
    path = folder / FILE
    tensors, about = read_tensors(path, FORMAT, VideoError)
    if about.get("model") not in VIDEO_MODELS:
        raise VideoError(f"{path}: unknown model {about.get('model')!r}; there are: {', '.join(VIDEO_MODELS)}")
    model: VideoModel
    if about["model"] == "planet":
        model = PlaNet(from_json(about["net"], PlanetNet, f"{path}: net"))
    else:
        model = VisualForesight(from_json(about["net"], ForesightNet, f"{path}: net"))
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        raise VideoError(f"{path}: its weights do not fit its config: {error}") from error
    return model.eval().requires_grad_(False), from_json(about["view"], OverheadView, f"{path}: view")
