"""Training of perception on recorded episodes, except the last ones, which validate it."""

from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from oes.config import params
from oes.objects import map_tensors
from oes.perception import evaluate
from oes.perception.losses import LOSS_TERMS, PerceptionBatch, losses
from oes.perception.network import PerceptionNet, PerceptionNetConfig
from oes.perception.perceiver import Perceiver
from oes.perception.samples import Sampler, Sampling
from oes.perception.solids import Solids
from oes.perception.surface_training import SurfaceTraining
from oes.record.dataset import FrameSource
from oes.training.checkpoint import LogRow
from oes.training.loop import TrainConfig, fit


@params
class PerceptionConfig:
    """The section ``perception`` of params.yaml.

    One network learns from the training episodes of all ``tasks``; the last ``validation_share`` of
    them, at most ``num_validation``, are for validation only. ``weights``: of the loss terms.
    ``num_proposals``: boxes of the network per scene that train the second stage, besides the
    ground truth. ``num_rendered``: untransformed scenes per batch that train the view decoder.
    ``num_solid_points``: per mesh. ``surface``: the later training of the surface head.
    """

    tasks: tuple[str, ...]
    network: PerceptionNetConfig
    sampling: Sampling
    weights: dict[str, float]
    num_proposals: int
    num_rendered: int
    num_solid_points: int
    validation_share: float
    num_validation: int
    fit: TrainConfig
    surface: SurfaceTraining

    def __post_init__(self) -> None:
        """Raises ValueError unless ``weights`` has exactly the keys ``LOSS_TERMS``."""
        if set(self.weights) != set(LOSS_TERMS):
            names = ", ".join(self.weights)
            raise ValueError(f"weights: expected exactly {', '.join(LOSS_TERMS)}; found {names}")

    def split(self, num_episodes: int) -> tuple[range, range]:
        """Indices of the training and the validation episodes."""
        share = max(1, round(num_episodes * self.validation_share))
        first = num_episodes - min(share, self.num_validation)
        # A single episode is for both.
        return range(max(1, first)), range(first, num_episodes)


def train_perception(
    cfg: PerceptionConfig, source: FrameSource, solids: Solids, work: Path, device: torch.device
) -> tuple[Perceiver, list[LogRow]]:
    """Train all but the surface head; returns the perceiver and the rows of the log.

    Continues from the checkpoint in ``work``, if there is one.
    """
    train_is, validation_is = cfg.split(len(source.episodes))
    torch.manual_seed(cfg.fit.seed)
    net = PerceptionNet(cfg.network)
    sampler = Sampler(
        cfg=cfg.sampling,
        batch=cfg.fit.batch,
        num_untransformed=cfg.num_rendered,
        seed=cfg.fit.seed,
        grid=cfg.network.grid,
        source=source,
        solids=solids,
        episode_is=train_is,
    )

    def loss(net: nn.Module, batch: PerceptionBatch) -> dict[str, Tensor]:
        assert isinstance(net, PerceptionNet)
        batch = map_tensors(batch, lambda x: x.to(device))
        return losses(net, batch, cfg.num_proposals, cfg.num_rendered)

    validate = partial(
        validation_metrics, source=source, solids=solids, episode_is=validation_is, device=device
    )
    rows = fit(net, sampler.batch_at, loss, cfg.weights, cfg.fit, work, device, validate)
    return Perceiver(net, device), rows


def validation_metrics(
    net: nn.Module, source: FrameSource, solids: Solids, episode_is: range, device: torch.device
) -> dict[str, float]:
    """``val_...``: detection and view prediction from one view of each episode's first state."""
    assert isinstance(net, PerceptionNet)
    perceiver = Perceiver(net, device)
    detections: list[evaluate.PerceptionRow] = []
    views: list[dict[str, float]] = []
    for episode_i in episode_is:
        # Seeded by the episode: the same cameras at every checkpoint, and no effect on training.
        rng = np.random.default_rng(episode_i)
        episode = source.episodes[episode_i]
        camera_is = rng.choice(len(episode.steps[0].cameras), 2, replace=False).tolist()
        scene = perceiver.encode(*source.read(episode_i, 0, camera_is[:1]))
        truth = evaluate.gt_objects(episode, 0, solids)
        rows = evaluate.detection_rows(perceiver, scene, truth)
        detections += [row | {"episode": episode_i} for row in rows]
        frames, (camera,) = source.read(episode_i, 0, camera_is[1:])
        image_HW3 = perceiver.render(scene, camera)
        views.append(evaluate.rgb_quality(image_HW3, frames.rgb_VHW3[0]))
    means = {name: float(np.mean([row[name] for row in views])) for name in views[0]}
    metrics = evaluate.detection_summary(detections) | means
    return {f"val_{name}": value for name, value in metrics.items()}
