"""Trained models on disk: ``model.safetensors`` with the model's word and its config as JSON metadata."""

from pathlib import Path

from torch import nn

from oes.config import from_json, to_json
from oes.dynamics import MODELS
from oes.dynamics.bounds import Simulator
from oes.dynamics.certainty import Certainty
from oes.dynamics.models import Learned, Net, Seen
from oes.dynamics.unroll import Model
from oes.weights import read_tensors, write_tensors

FILE = "model.safetensors"
FORMAT = "oes-dynamics-2"


class CheckpointError(ValueError):
    """A file that does not hold the model it should; the message names it and says what it holds."""


def save_model(folder: Path, model: nn.Module) -> None:
    """Write a model of ``MODELS``; the file appears whole."""
    word = next(word for word, kind in MODELS.items() if type(model) is kind)
    about = {"format": FORMAT, "model": word}
    if isinstance(model, Learned):
        about |= {"net": to_json(model.net), "seen": to_json(model.seen)}
        about |= {"certainty": to_json(model.certainty)} if model.certainty is not None else {}
    write_tensors(model.state_dict(), folder / FILE, about)


def load_model(folder: Path) -> Model:
    """The forecaster in ``folder``, ready to use (eval mode).

    Raises FileNotFoundError, and CheckpointError for a file that is broken, foreign, of another shape than its own
    config says, or not a forecaster (the simulator). A config that does not fit raises ParamsError.
    """
    model = load(folder)
    if not isinstance(model, Model):
        raise CheckpointError(f"{folder / FILE}: holds a {type(model).__name__}, which is not a forecaster")
    return model


def load(folder: Path) -> Model | Simulator:
    """Whatever model is in ``folder``. Raises as ``load_model``."""
    path = folder / FILE
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such model")
    tensors, about = read_tensors(path, FORMAT, CheckpointError)
    if about.get("model") not in MODELS:
        raise CheckpointError(f"{path}: unknown model {about.get('model')!r}; there are: {', '.join(MODELS)}")
    kind = MODELS[about["model"]]
    model: nn.Module
    if issubclass(kind, Learned):
        net = from_json(about.get("net", "null"), Net, f"{path}: net")
        model = kind(net, from_json(about.get("seen", "null"), Seen, f"{path}: seen"))
        if "certainty" in about:
            model.certainty = from_json(about["certainty"], Certainty, f"{path}: certainty")
    else:
        model = kind()
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        raise CheckpointError(f"{path}: its weights do not fit its config: {error}") from error
    assert isinstance(model, Model | Simulator)
    return model.eval().requires_grad_(False)
