"""Trained models on disk: ``model.safetensors`` with the model's word and its config as JSON
metadata.
"""

from pathlib import Path

from torch import nn

from oes.config import from_json, to_json
from oes.dynamics import MODELS
from oes.dynamics.error_model import ErrorModel
from oes.dynamics.models import GraphModel, InputSpec, NetConfig
from oes.dynamics.reference_models import Simulator
from oes.dynamics.unroll import DynamicsModel
from oes.training.tensor_io import read_tensors, write_tensors

MODEL_FILE = "model.safetensors"
DYNAMICS_FORMAT = "oes-dynamics-2"


class ModelFileError(ValueError):
    """A file that does not hold the model it should; the message names it and says what it
    holds.
    """


def save_model(folder: Path, model: nn.Module) -> None:
    """Write a model of ``MODELS``; the file appears whole."""
    word = next(word for word, kind in MODELS.items() if type(model) is kind)
    about = {"format": DYNAMICS_FORMAT, "model": word}
    if isinstance(model, GraphModel):
        about |= {"net": to_json(model.net), "seen": to_json(model.seen)}
        about |= {"certainty": to_json(model.error_model)} if model.error_model is not None else {}
    write_tensors(model.state_dict(), folder / MODEL_FILE, about)


def load_model(folder: Path) -> DynamicsModel:
    """The forecaster in ``folder``, ready to use (eval mode).

    Raises FileNotFoundError, and CheckpointError for a file that is broken, foreign, of another
    shape than its own config says, or not a forecaster (the simulator). A config that does not fit
    raises ParamsError.
    """
    model = load_any_model(folder)
    if not isinstance(model, DynamicsModel):
        raise ModelFileError(
            f"{folder / MODEL_FILE}: holds a {type(model).__name__}, which is not a forecaster"
        )
    return model


def load_any_model(folder: Path) -> DynamicsModel | Simulator:
    """Whatever model is in ``folder``. Raises as ``load_model``."""
    path = folder / MODEL_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such model")
    tensors, about = read_tensors(path, DYNAMICS_FORMAT, ModelFileError)
    if about.get("model") not in MODELS:
        raise ModelFileError(
            f"{path}: unknown model {about.get('model')!r}; there are: {', '.join(MODELS)}"
        )
    kind = MODELS[about["model"]]
    model: nn.Module
    if issubclass(kind, GraphModel):
        net = from_json(about.get("net", "null"), NetConfig, f"{path}: net")
        model = kind(net, from_json(about.get("seen", "null"), InputSpec, f"{path}: seen"))
        if "certainty" in about:
            model.error_model = from_json(about["certainty"], ErrorModel, f"{path}: certainty")
    else:
        model = kind()
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        raise ModelFileError(f"{path}: its weights do not fit its config: {error}") from error
    assert isinstance(model, DynamicsModel | Simulator)
    return model.eval().requires_grad_(False)
