"""From perceived training scenes and their episodes to a trained model of ``MODELS``."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor, nn

from oes.dynamics import MODELS, VARIANTS
from oes.dynamics.augment import Augment
from oes.dynamics.examples import Examples, make_examples
from oes.dynamics.models import GraphModel, InputSpec
from oes.dynamics.reference_models import Simulator
from oes.dynamics.train import TaskConfig, train_dynamics
from oes.episode import Episode
from oes.objects import Objects
from oes.training.checkpoint import TrainConfig

LogRows = list[dict[str, float]]


class ModelNameError(ValueError):
    """A name that is neither a model nor a variant; the message lists the valid ones."""


class Scenes(Protocol):
    """Part of ``oes.perception.objects_file.ObjectStore`` that training needs."""

    def observations(self, setting: str) -> list[int]:
        """Indices of the observations of one setting."""

    def episode(self, observation_i: int) -> int:
        """Index of the observation's episode."""

    def scene(self, observation_i: int) -> tuple[Objects, Tensor]:
        """Objects of the observation and the true object of each (-1: none)."""

    def with_gt_surfaces(self) -> "Scenes":
        """The same scenes with ground-truth surfaces."""


@dataclass(frozen=True)
class ModelSpec:
    """Class of a model and the settings that it is trained under, with its variant applied."""

    kind: type[nn.Module]
    cfg: TaskConfig
    fit: TrainConfig
    num_episodes: int | None  # None: all


def resolve_model(name: str, cfg: TaskConfig) -> ModelSpec:
    """Look up a model or a variant. Raises ModelNameError."""
    if name not in (known := [*MODELS, *VARIANTS]):
        raise ModelNameError(f"unknown model {name!r}; valid: {', '.join(known)}")
    base = VARIANTS.get(name, name)
    fit = cfg.fit_overrides.get(base, cfg.fit)
    if name not in VARIANTS:
        return ModelSpec(MODELS[base], cfg, fit, None)
    if name not in cfg.variants:
        raise ModelNameError(f"no variant {name!r}; variants: {', '.join(cfg.variants)}")
    variant = cfg.variants[name]
    no_augment = Augment(rotate=False, mirror=False, shift_sigma_m=0.0)
    contact = replace(cfg.net.contact, gt_surfaces=variant.gt_surfaces)
    cfg = replace(
        cfg,
        net=replace(cfg.net, contact=contact),
        augment=cfg.augment if variant.augment else no_augment,
        unroll=variant.unroll,
    )
    return ModelSpec(MODELS[base], cfg, fit, variant.num_episodes or None)


def build_model(
    spec: ModelSpec, scenes: Scenes, episodes: Mapping[int, Episode], work: Path
) -> tuple[nn.Module, LogRows]:
    """A model and its log: trained, measured (the simulator) or unchanged (static).

    ``episodes`` by index; observations of other episodes are ignored. Progress is kept in ``work``.
    """
    episodes = dict(list(episodes.items())[: spec.num_episodes])
    if issubclass(spec.kind, GraphModel):
        if spec.cfg.net.contact.gt_surfaces:
            scenes = scenes.with_gt_surfaces()
        inputs, examples = training_examples(spec.kind, spec.cfg, scenes, episodes)
        torch.manual_seed(spec.fit.seed)
        trained = spec.kind(spec.cfg.net, inputs)
        return trained, train_dynamics(trained, examples, spec.cfg, spec.fit, work)
    model = spec.kind()
    if isinstance(model, Simulator):
        model.measure(list(episodes.values()))
    return model, []


def training_examples(
    kind: type[GraphModel], cfg: TaskConfig, scenes: Scenes, episodes: Mapping[int, Episode]
) -> tuple[InputSpec, Examples]:
    """All observations that a kind of model trains on, and the sizes of their tensors.

    Raises ValueError when ``cfg.observations`` has none for its cameras, or no object is left.
    """
    if kind.CAMERAS not in (settings := cfg.observations):
        raise ValueError(f"observations has no {kind.CAMERAS!r}; it has: {', '.join(settings)}")
    perceived = [
        (objects, truth.tolist(), scenes.episode(i))
        for setting in settings[kind.CAMERAS]
        for i in scenes.observations(setting)
        if scenes.episode(i) in episodes
        for objects, truth in [scenes.scene(i)]
        if len(truth)
    ]
    if not perceived:
        raise ValueError(f"no object in any observation of {', '.join(settings[kind.CAMERAS])}")
    first = perceived[0][0]
    inputs = InputSpec(
        crop_channels=first.crop_NCXYZ.shape[1],
        crop_side=first.crop_NCXYZ.shape[-1],
        voxel_m=cfg.voxel_m,
        image_side_px=first.image_NV3HW.shape[-1],
        profile_rows=first.radial_profile_NRD3.shape[1],
        profile_directions=first.radial_profile_NRD3.shape[2],
    )
    needed = [(_needed(kind, cfg, objects), truth, i) for objects, truth, i in perceived]
    return inputs, make_examples(needed, episodes)


def _needed(kind: type[GraphModel], cfg: TaskConfig, objects: Objects) -> Objects:
    """Objects whose unused tensors are empty or tiny: all observations stay in memory."""
    num_channels = cfg.net.crop.num_channels if kind.USES_CROPS else 0
    objects = replace(objects, crop_NCXYZ=objects.crop_NCXYZ[:, :num_channels].half())
    # Clones release the large tensors that slices would keep alive.
    if not kind.USES_SURFACES:
        profile = objects.radial_profile_NRD3[:, :1, :1].clone()
        objects = replace(objects, radial_profile_NRD3=profile)
    if not kind.USES_IMAGES:
        objects = replace(objects, image_NV3HW=objects.image_NV3HW[..., :1, :1].clone())
    return objects
