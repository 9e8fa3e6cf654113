"""Training perception on recorded episodes; the last ones are kept for validation."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from oes.config import params
from oes.perception.evaluate import (
    PerceptionRow,
    detection_rows,
    detection_summary,
    gt_objects,
    view_row,
)
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.losses import LOSS_TERMS, PerceptionBatch, losses
from oes.perception.network import PerceptionNet, PerceptionNetConfig
from oes.perception.perceiver import Perceiver
from oes.perception.samples import Sampler, Sampling, Source
from oes.perception.solids import Solids
from oes.perception.surface_training import SurfaceSampler, SurfaceTraining, train_surface
from oes.training.loop import TrainConfig, fit


@params
class PerceptionConfig:
    """The section ``perception`` of params.yaml.

    ``weights`` of the loss terms; ``num_proposals`` of the net's own boxes a scene train the second
    stage and ``num_rendered`` scenes a batch, unmoved, the view decoder. ``num_solid_points``
    describe each mesh. The last ``validation_share`` of the episodes, at most ``num_validation`` of
    them, are never trained on. One network serves all ``tasks``: it learns from the training
    episodes of each. ``surface``: how its surface head is trained after it.
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
        """Raises ValueError (a ParamsError when read from params.yaml) where the weights do not
        name the losses.
        """
        if set(self.weights) != set(LOSS_TERMS):
            raise ValueError(
                f"weights: expected exactly {', '.join(LOSS_TERMS)}; found {', '.join(self.weights)}"
            )


def train_perception(
    cfg: PerceptionConfig,
    source: Source,
    solids: Solids,
    gt_profiles: GroundTruthProfiles,
    work: Path,
    device: torch.device,
) -> tuple[Perceiver, list[dict[str, float]], list[dict[str, float]]]:
    """Train from scratch, or go on from the progress kept in ``work``. The perceiver, the rows of
    its log, and those of the surface head's, which is trained once all else is.
    """
    count = len(source.episodes)
    held_out = min(max(1, round(count * cfg.validation_share)), cfg.num_validation)
    torch.manual_seed(cfg.fit.seed)
    net = PerceptionNet(cfg.network)
    sampler = Sampler(
        cfg=cfg.sampling,
        batch=cfg.fit.batch,
        num_still=cfg.num_rendered,
        seed=cfg.fit.seed,
        grid=cfg.network.grid,
        source=source,
        solids=solids,
        episode_is=range(max(1, count - held_out)),
    )
    validate = partial(
        validation_metrics,
        source=source,
        solids=solids,
        episode_is=range(count - held_out, count),
        device=device,
    )
    rows = fit(
        net, sampler.batch_at, _Loss(cfg, device), cfg.weights, cfg.fit, work, device, validate
    )
    perceiver = Perceiver(net, device)
    episode_is = (range(max(1, count - held_out)), range(count - held_out, count))
    (work / "surface").mkdir(exist_ok=True)
    surface_sampler = SurfaceSampler(perceiver, source, gt_profiles, cfg.surface)
    return perceiver, rows, train_surface(surface_sampler, episode_is, work / "surface")


@dataclass(frozen=True)
class _Loss:
    """The loss of one batch, as ``fit`` calls it."""

    cfg: PerceptionConfig
    device: torch.device

    def __call__(self, net: nn.Module, batch: PerceptionBatch) -> dict[str, Tensor]:
        """Named terms."""
        assert isinstance(net, PerceptionNet)
        return losses(net, batch.to(self.device), self.cfg.num_proposals, self.cfg.num_rendered)


def validation_metrics(
    net: nn.Module, source: Source, solids: Solids, episode_is: range, device: torch.device
) -> dict[str, float]:
    """Detection and view prediction from one view of the first state of some episodes, as
    ``val_...``.
    """
    assert isinstance(net, PerceptionNet)
    perceiver = Perceiver(net, device)
    rows: list[PerceptionRow] = []
    views: list[PerceptionRow] = []
    for episode_i in episode_is:
        rng = np.random.default_rng(episode_i)
        camera_i, query_i = rng.choice(
            len(source.episodes[episode_i].steps[0].cameras), 2, replace=False
        ).tolist()
        scene = perceiver.encode(*source.read(episode_i, 0, [camera_i]))
        truth = gt_objects(source.episodes[episode_i], 0, solids)
        rows += [row | {"episode": episode_i} for row in detection_rows(perceiver, scene, truth)]
        frames, (camera,) = source.read(episode_i, 0, [query_i])
        views.append(view_row(perceiver, scene, frames, camera))
    means = {name: float(np.mean([row[name] or 0.0 for row in views])) for name in views[0]}
    return {f"val_{name}": value for name, value in (detection_summary(rows) | means).items()}
