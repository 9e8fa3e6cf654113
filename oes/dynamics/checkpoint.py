"""Trained models on disk: ``model.safetensors``, with the name and config as JSON metadata."""

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
DYNAMICS_FORMAT = "oes-dynamics-3"


class ModelFileError(ValueError):
    """A file that does not hold the expected model; the message names it and its content."""


def save_model(folder: Path, model: nn.Module) -> None:
    """Write a model of ``MODELS``; the file appears whole."""
    name = next(name for name, kind in MODELS.items() if type(model) is kind)
    metadata = {"format": DYNAMICS_FORMAT, "model": name}
    if isinstance(model, GraphModel):
        metadata |= {"net": to_json(model.net), "inputs": to_json(model.inputs)}
        if model.error_model is not None:
            metadata["error_model"] = to_json(model.error_model)
    write_tensors(model.state_dict(), folder / MODEL_FILE, metadata)


def load_model(folder: Path) -> DynamicsModel:
    """The forecaster in ``folder``, in eval mode.

    Raises FileNotFoundError; ModelFileError for a file that is broken, of another format, not a
    forecaster (the simulator), or whose weights do not fit its config; ParamsError for a config
    that is not valid.
    """
    model = load_any_model(folder)
    if not isinstance(model, DynamicsModel):
        name = type(model).__name__
        raise ModelFileError(f"{folder / MODEL_FILE}: holds a {name}, which is not a forecaster")
    return model


def load_any_model(folder: Path) -> DynamicsModel | Simulator:
    """The model in ``folder``. Raises as ``load_model``."""
    path = folder / MODEL_FILE
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such model")
    tensors, metadata = read_tensors(path, DYNAMICS_FORMAT, ModelFileError)
    if (name := metadata.get("model")) not in MODELS:
        raise ModelFileError(f"{path}: unknown model {name!r}; valid: {', '.join(MODELS)}")
    kind = MODELS[name]
    model: nn.Module
    if issubclass(kind, GraphModel):
        net = from_json(metadata.get("net", "null"), NetConfig, f"{path}: net")
        inputs = from_json(metadata.get("inputs", "null"), InputSpec, f"{path}: inputs")
        model = kind(net, inputs)
        if (stored := metadata.get("error_model")) is not None:
            model.error_model = from_json(stored, ErrorModel, f"{path}: error_model")
    else:
        model = kind()
    try:
        model.load_state_dict(tensors)
    except RuntimeError as error:
        raise ModelFileError(f"{path}: its weights do not fit its config: {error}") from error
    assert isinstance(model, DynamicsModel | Simulator)
    return model.eval().requires_grad_(False)
