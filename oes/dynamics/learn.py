"""From perceived training scenes and what happened in them to a model of ``MODELS``."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor, nn

from oes.dynamics import MODELS, VARIANTS
from oes.dynamics.augment import Augment
from oes.dynamics.examples import Examples, examples
from oes.dynamics.models import GraphModel, InputSpec
from oes.dynamics.reference_models import Simulator
from oes.dynamics.train import TaskConfig, train_dynamics
from oes.episode import Episode
from oes.objects import Objects

LogRows = list[dict[str, float]]


class Scenes(Protocol):
    """What training needs of the objects file (``oes.perception.objects_file.ObjectStore``)."""

    def draws(self, setting: str) -> list[int]:
        """Numbers of the draws of one setting."""

    def episode(self, draw_i: int) -> int:
        """The number of the draw's episode."""

    def scene(self, draw_i: int) -> tuple[Objects, Tensor]:
        """The draw's objects and the true object of each (-1: none)."""

    def with_gt_surfaces(self) -> "Scenes":
        """The same with the surfaces that the objects truly have."""


def build_model(
    word: str, cfg: TaskConfig, scenes: Scenes, episodes: Mapping[int, Episode], work: Path
) -> tuple[nn.Module, LogRows]:
    """Make the model of ``MODELS`` or ``VARIANTS`` called ``word``: train what learns, measure what
    the simulator needs, and nothing for static.

    ``episodes`` by their number; draws of an episode that is missing are left out. Returns the
    model and the rows of its log. Progress is kept in ``work``.
    """
    if word in VARIANTS:
        cfg, episodes = variant_config(word, cfg, episodes)
    kind = MODELS[VARIANTS.get(word, word)]
    if issubclass(kind, GraphModel):
        settings = cfg.fit_of(VARIANTS.get(word, word))
        if cfg.net.contact.gt_surfaces:
            scenes = scenes.with_gt_surfaces()
        seen, data = training_examples(kind, cfg, scenes, episodes)
        torch.manual_seed(settings.seed)
        learned = kind(cfg.net, seen)
        return learned, train_dynamics(learned, data, cfg, settings, work)
    model = kind()
    if isinstance(model, Simulator):
        model.measure(list(episodes.values()))
    return model, []


def variant_config(
    word: str, cfg: TaskConfig, episodes: Mapping[int, Episode]
) -> tuple[TaskConfig, Mapping[int, Episode]]:
    """Settings and episodes of a variant. Raises ValueError where ``cfg.variants`` lacks it."""
    if word not in cfg.variants:
        raise ValueError(f"dynamics.variants has no {word!r}; it has: {', '.join(cfg.variants)}")
    variant = cfg.variants[word]
    return replace(
        cfg,
        net=replace(cfg.net, contact=replace(cfg.net.contact, gt_surfaces=variant.gt_surfaces)),
        augment=cfg.augment if variant.augment else Augment(turn=False, mirror=False, shift_m=0.0),
        unroll=variant.unroll,
    ), dict(list(episodes.items())[: variant.episodes or None])


def training_examples(
    kind: type[GraphModel], cfg: TaskConfig, scenes: Scenes, episodes: Mapping[int, Episode]
) -> tuple[InputSpec, Examples]:
    """All draws that a kind of model learns from, with the sizes of what perception delivers.

    Raises ValueError for a kind of views that ``cfg.draws`` does not name, and when no draw is
    left.
    """
    if kind.DRAWS not in cfg.draws:
        raise ValueError(f"dynamics.draws has no {kind.DRAWS!r}; it has: {', '.join(cfg.draws)}")
    draw_is = [
        i
        for setting in cfg.draws[kind.DRAWS]
        for i in scenes.draws(setting)
        if scenes.episode(i) in episodes
    ]
    found = [(*scenes.scene(i), scenes.episode(i)) for i in draw_is]
    found = [(objects, truth, episode_i) for objects, truth, episode_i in found if len(truth)]
    if not found:
        raise ValueError(f"no object in any draw of {', '.join(cfg.draws[kind.DRAWS])}")
    first = found[0][0]
    seen = InputSpec(
        first.crop_NCXYZ.shape[1],
        first.crop_NCXYZ.shape[-1],
        cfg.voxel_m,
        first.image_NV3HW.shape[-1],
        *first.radial_profile_NRD3.shape[1:3],
    )
    data = examples(
        [(_needed(kind, cfg, objects), truth.tolist()) for objects, truth, _ in found],
        [episodes[episode_i] for *_, episode_i in found],
        [episode_i for *_, episode_i in found],
        cfg.voxel_m,
    )
    return seen, data


def _needed(kind: type[GraphModel], cfg: TaskConfig, objects: Objects) -> Objects:
    """Half-precision crops of the channels read, and images, only for those who look at them: all
    stays in memory.
    """
    channels = cfg.net.crop.read if kind.READS_CROPS else 0
    objects = replace(objects, crop_NCXYZ=objects.crop_NCXYZ[:, :channels].half())
    if not kind.READS_SURFACES:
        objects = replace(
            objects, radial_profile_NRD3=objects.radial_profile_NRD3[:, :1, :1].clone()
        )
    return (
        objects
        if kind.READS_IMAGES
        else replace(objects, image_NV3HW=objects.image_NV3HW[..., :1, :1].clone())
    )
