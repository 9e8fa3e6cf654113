"""Training of the surface head on features of many objects from the trained, frozen network.

The features are computed once and kept in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from oes.config import params
from oes.geom.polar import directions
from oes.objects import LAYERS, SUPPORT, UNION, map_tensors
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.perceiver import Perceiver
from oes.perception.samples import IDENTITY, transform_views
from oes.perception.surface import SurfaceOutput, support_points
from oes.progress import progress_bar
from oes.record.dataset import FrameSource
from oes.training.checkpoint import LogRow, TrainConfig
from oes.training.loop import fit

LENGTH_UNIT_M = 0.01
SUMMARY_WEIGHT = 4.0  # of the rows above the single layers in the loss, since dynamics reads them
TERMS = ("radius", "presence", "com_offset")


@params
class SurfaceTraining:
    """Training of the surface head on ``num_objects`` objects at noisy ground-truth boxes.

    Jitters are standard deviations. ``scale``: range of the random scale of the world.
    """

    num_objects: int
    center_jitter_m: float
    size_jitter: float
    scale: tuple[float, float]
    fit: TrainConfig


@dataclass(frozen=True)
class SurfaceBatch:
    """P objects: inputs of the head, ground-truth radii (0: no surface) and centres of mass.

    Centres of mass are relative to the centres of the boxes. Inputs are float16 in memory.
    """

    inputs_PCDX: Tensor
    radius_PRD: Tensor
    com_offset_P3: Tensor

    def __len__(self) -> int:
        return len(self.com_offset_P3)


def rotate_batch(batch: SurfaceBatch, num_steps: int, is_mirrored: bool) -> SurfaceBatch:
    """The objects after mirroring y (optional) and a rotation by ``num_steps`` directions."""
    count = batch.radius_PRD.shape[-1]
    old_D = (torch.arange(count) - num_steps) % count
    old_D = -old_D % count if is_mirrored else old_D
    cos, sin = directions(count)[num_steps % count]
    new_R_old = torch.stack([torch.stack([cos, -sin]), torch.stack([sin, cos])])
    new_R_old = new_R_old @ torch.diag(torch.tensor([1.0, -1.0 if is_mirrored else 1.0]))
    xy_P2 = batch.com_offset_P3[:, :2] @ new_R_old.mT
    return SurfaceBatch(
        inputs_PCDX=batch.inputs_PCDX[:, :, old_D],
        radius_PRD=batch.radius_PRD[..., old_D],
        com_offset_P3=torch.cat([xy_P2, batch.com_offset_P3[:, 2:]], -1),
    )


@dataclass(frozen=True)
class SurfaceSampler:
    """Objects of random states of a source, each perceived from one to three random views."""

    perceiver: Perceiver
    source: FrameSource
    gt_profiles: GroundTruthProfiles
    cfg: SurfaceTraining

    def gather(self, num: int, episode_is: Sequence[int]) -> SurfaceBatch:
        """At least ``num`` objects of random episodes among ``episode_is``."""
        rng = np.random.default_rng(self.cfg.fit.seed)
        parts: list[SurfaceBatch] = []
        with progress_bar(total=num, desc="perceiving for the surface head", unit="object") as bar:
            while bar.n < num:
                parts.append(self._sample(int(rng.choice(episode_is)), rng))
                bar.update(min(len(parts[-1]), num - bar.n))
        return map_tensors(parts[0], lambda *values: torch.cat(values), *parts[1:])

    def _sample(self, episode_i: int, rng: np.random.Generator) -> SurfaceBatch:
        cfg, perceiver, episode = self.cfg, self.perceiver, self.source.episodes[episode_i]
        step_i = int(rng.integers(len(episode.steps)))
        step, scale = episode.steps[step_i], rng.uniform(*cfg.scale)
        camera_is = rng.choice(len(step.cameras), int(rng.integers(1, 4)), replace=False).tolist()
        images = self.source.read(episode_i, step_i, camera_is)
        views = transform_views(*images, replace(IDENTITY, scale=scale))
        true_N3, grid = step.center_N3 * scale, perceiver.net.cfg.grid
        low_3 = np.array(grid.min_m)
        # Only objects in the grid of the scene map are perceived.
        in_grid_N3 = (true_N3 > low_3) & (true_N3 < low_3 + grid.size_m)
        object_is = np.flatnonzero(in_grid_N3.all(-1)).tolist()
        jitter_N3 = rng.normal(0, cfg.center_jitter_m, true_N3.shape)
        stretch_N3 = np.exp(rng.normal(0, cfg.size_jitter, true_N3.shape))
        center_N3 = (true_N3 + jitter_N3)[object_is]
        size_N3 = (step.size_N3 * scale * stretch_N3)[object_is]
        boxes = torch.from_numpy(center_N3).float(), torch.from_numpy(size_N3).float()
        # Ray casting in float64 starts at the axis before it is rounded to float32.
        base_N1 = support_points(*boxes)[:, 2:].double().numpy()
        support_N3 = np.concatenate([center_N3[:, :2], base_N1], -1)
        poses_N44 = step.world_T_obj_N44[object_is]
        poses_N44[:, :3, 3] *= scale
        bodies = [episode.bodies[i] for i in object_is]
        bodies = [replace(body, scale_3=body.scale_3 * scale) for body in bodies]
        radius_NRD, com_N3 = self.gt_profiles.of_bodies(bodies, poses_N44, support_N3)
        features = perceiver.encode_views(views)
        masks = perceiver.masks(features, boxes)
        inputs_PCDX = perceiver.surface_inputs(features, boxes, masks)
        return SurfaceBatch(
            inputs_PCDX=inputs_PCDX.half().cpu(),
            radius_PRD=torch.from_numpy(radius_NRD).float(),
            com_offset_P3=torch.from_numpy(com_N3 - center_N3).float(),
        )


def train_surface(
    sampler: SurfaceSampler, episode_is: tuple[Sequence[int], Sequence[int]], work: Path
) -> list[LogRow]:
    """Train the perceiver's surface head in place; the rest of the network is frozen.

    ``episode_is``: training and validation episodes. Returns the rows of the log; checkpoints are
    kept in ``work``.
    """
    head, device, cfg = sampler.perceiver.net.surface, sampler.perceiver.device, sampler.cfg
    train = sampler.gather(cfg.num_objects, episode_is[0])
    validation = sampler.gather(max(1, cfg.num_objects // 15), episode_is[1])
    validation = map_tensors(validation, lambda x: x.to(device))

    def batch_at(step: int) -> SurfaceBatch:
        generator = torch.Generator().manual_seed(cfg.fit.seed * 1_000_003 + step)
        chosen_P = torch.randint(len(train), (cfg.fit.batch,), generator=generator)
        num_turns = train.radius_PRD.shape[-1] * 2
        turn_i = int(torch.randint(num_turns, (1,), generator=generator))
        batch = map_tensors(train, lambda x: x[chosen_P].float())
        batch = rotate_batch(batch, turn_i // 2, turn_i % 2 == 1)
        return map_tensors(batch, lambda x: x.to(device))

    weights, validate = dict.fromkeys(TERMS, 1.0), partial(surface_metrics, batch=validation)
    with torch.enable_grad():
        rows = fit(head, batch_at, surface_losses, weights, cfg.fit, work, device, validate)
    head.requires_grad_(True)
    return rows


def surface_losses(net: nn.Module, batch: SurfaceBatch) -> dict[str, Tensor]:
    """Loss terms ``TERMS``, lengths in units of 10 mm.

    ``radius``: Laplace negative log-likelihood where a surface exists. ``presence``: binary
    cross-entropy. ``com_offset``: Euclidean distance.
    """
    output: SurfaceOutput = net(batch.inputs_PCDX)
    present_PRD = (batch.radius_PRD > 0).float()
    weight_R1 = torch.ones(present_PRD.shape[1], 1, device=present_PRD.device)
    weight_R1[:LAYERS] = SUMMARY_WEIGHT
    weight_PRD = present_PRD * weight_R1
    log_scale_PRD = (output.scale_PRD / LENGTH_UNIT_M).log()
    nll_PRD = (output.radius_PRD - batch.radius_PRD).abs() / output.scale_PRD + log_scale_PRD
    com_error_P = (output.com_offset_P3 - batch.com_offset_P3).norm(dim=-1)
    return {
        "radius": (nll_PRD * weight_PRD).sum() / weight_PRD.sum(),
        "presence": F.binary_cross_entropy_with_logits(output.presence_logit_PRD, present_PRD),
        "com_offset": com_error_P.mean() / LENGTH_UNIT_M,
    }


@torch.no_grad()
def surface_metrics(net: nn.Module, batch: SurfaceBatch) -> dict[str, float]:
    """Mean errors of radii (per type of row) and of centres of mass, share of wrong presences."""
    parts = [net(batch.inputs_PCDX[i : i + 64].float()) for i in range(0, len(batch), 64)]
    output = map_tensors(parts[0], lambda *values: torch.cat(values), *parts[1:])
    present_PRD = batch.radius_PRD > 0
    error_mm_PRD = (output.radius_PRD - batch.radius_PRD).abs() * 1e3
    rows: dict[str, int | slice]
    rows = {"union": UNION, "support": SUPPORT, "layer": slice(LAYERS, None)}
    metrics = {
        f"val_{name}_mm": float(error_mm_PRD[:, row][present_PRD[:, row]].mean())
        for name, row in rows.items()
    }
    is_wrong_PRD = (output.presence_logit_PRD > 0) != present_PRD
    com_error_P = (output.com_offset_P3 - batch.com_offset_P3).norm(dim=-1)
    metrics["val_presence_error"] = float(is_wrong_PRD.float().mean())
    return metrics | {"val_com_offset_mm": float(com_error_P.mean()) * 1e3}
