"""Training the surface head: what a trained, frozen network sees of many objects, gathered once,
then many passes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn
from tqdm import tqdm

from oes.config import params
from oes.episode import Floats
from oes.geom.boxes import base
from oes.geom.polar import directions
from oes.objects import LAYERS, SUPPORT, UNION
from oes.perception.gt_profiles import GroundTruthProfiles
from oes.perception.perceiver import Perceiver
from oes.perception.samples import Source, WorldTransform, transform_views
from oes.perception.surface import SurfaceHead
from oes.training.checkpoint import LogRow, TrainConfig
from oes.training.loop import fit

MM_10 = 0.01
SUMMARY_WEIGHT = (
    4.0  # how much more the outlines of all bands together, and of the foot, count than each band's
)
TERMS = ("radius", "presence", "mass")


@params
class SurfaceTraining:
    """How many objects to gather, how their true boxes are jittered (standard deviations), the
    range of world scales, and the training.
    """

    objects: int
    center_jitter_m: float
    size_jitter: float
    scale: tuple[float, float]
    fit: TrainConfig


@dataclass(frozen=True)
class SurfaceBatch:
    """P gathered objects: inputs PCKL (half precision), true radii PRK (0: nothing) and centres of
    mass P3, from the centres of their boxes.
    """

    inputs_PCKL: Tensor
    radius_PRK: Tensor
    mass_P3: Tensor

    def pick(self, chosen_P: Tensor) -> "SurfaceBatch":
        """Some of them, in float32."""
        return SurfaceBatch(**{name: value[chosen_P].float() for name, value in vars(self).items()})

    def to(self, device: torch.device) -> "SurfaceBatch":
        """The same elsewhere."""
        return SurfaceBatch(**{name: value.to(device) for name, value in vars(self).items()})


def rotate_lessons(lessons: SurfaceBatch, by: int, is_mirrored: bool) -> SurfaceBatch:
    """The same objects in a world turned by ``by`` directions after, if asked for, being mirrored
    in y.
    """
    count = lessons.radius_PRK.shape[-1]
    old_K = (torch.arange(count) - by) % count
    old_K = -old_K % count if is_mirrored else old_K
    cos, sin = directions(count)[by % count]
    new_M_old = torch.stack([torch.stack([cos, -sin]), torch.stack([sin, cos])])
    new_M_old = new_M_old @ torch.diag(torch.tensor([1.0, -1.0 if is_mirrored else 1.0]))
    side_P2 = lessons.mass_P3[:, :2] @ new_M_old.mT
    return SurfaceBatch(
        inputs_PCKL=lessons.inputs_PCKL[:, :, old_K],
        radius_PRK=lessons.radius_PRK[..., old_K],
        mass_P3=torch.cat([side_P2, lessons.mass_P3[:, 2:]], -1),
    )


def gather_objects(
    perceiver: Perceiver,
    source: Source,
    shells: GroundTruthProfiles,
    cfg: SurfaceTraining,
    num: int,
    episode_is: Sequence[int],
) -> SurfaceBatch:
    """At least ``num`` objects of random states of some episodes, each seen by one to three random
    views.
    """
    rng = np.random.default_rng(cfg.fit.seed)
    parts: list[SurfaceBatch] = []
    with tqdm(total=num, desc="surfaces seen", unit="object", disable=None, mininterval=1) as bar:
        while (count := sum(len(part.mass_P3) for part in parts)) < num:
            bar.update(count - bar.n)
            parts.append(_scene(perceiver, source, shells, cfg, int(rng.choice(episode_is)), rng))
    return SurfaceBatch(
        **{name: torch.cat([getattr(part, name) for part in parts]) for name in vars(parts[0])}
    )


def _scene(
    perceiver: Perceiver,
    source: Source,
    shells: GroundTruthProfiles,
    cfg: SurfaceTraining,
    episode_i: int,
    rng: np.random.Generator,
) -> SurfaceBatch:
    """The objects of one random state."""
    episode = source.episodes[episode_i]
    step_i = int(rng.integers(len(episode.steps)))
    step, scale = episode.steps[step_i], rng.uniform(*cfg.scale)
    camera_is = rng.choice(len(step.cameras), int(rng.integers(1, 4)), replace=False).tolist()
    views = transform_views(
        *source.read(episode_i, step_i, camera_is), WorldTransform(np.eye(3), scale, np.zeros(3))
    )
    true_N3, inside = step.center_N3 * scale, _inside(perceiver, step.center_N3 * scale)
    center_N3 = (true_N3 + rng.normal(0, cfg.center_jitter_m, true_N3.shape))[inside]
    size_N3 = (step.size_N3 * scale * np.exp(rng.normal(0, cfg.size_jitter, true_N3.shape)))[inside]
    centers, sizes = torch.from_numpy(center_N3).float(), torch.from_numpy(size_N3).float()
    foot_N3 = np.column_stack([center_N3[:, :2], base(centers, sizes).double().numpy()])
    bodies = tuple(replace(body, scale_3=body.scale_3 * scale) for body in episode.bodies)
    poses_N44 = step.world_T_obj_N44.copy()
    poses_N44[:, :3, 3] *= scale
    grown = replace(episode, bodies=bodies, steps=(replace(step, world_T_obj_N44=poses_N44),))
    radius_NRK, mass_N3 = shells.outlines(grown, 0, foot_N3, inside)
    return SurfaceBatch(
        inputs_PCKL=perceiver.cylinders(perceiver.encode_views(views), centers[None], sizes[None])
        .half()
        .cpu(),
        radius_PRK=torch.from_numpy(radius_NRK).float(),
        mass_P3=torch.from_numpy(mass_N3 - center_N3).float(),
    )


def _inside(perceiver: Perceiver, center_N3: Floats) -> list[int]:
    """Numbers of the objects in the scene map's grid."""
    grid = perceiver.net.cfg.grid
    low = np.array(grid.min_m)
    inside_N3 = (center_N3 > low) & (center_N3 < low + grid.size_m)
    return [int(i) for i in np.flatnonzero(inside_N3.all(-1))]


def train_surface(
    perceiver: Perceiver,
    source: Source,
    shells: GroundTruthProfiles,
    cfg: SurfaceTraining,
    episode_is: tuple[Sequence[int], Sequence[int]],
    work: Path,
) -> list[LogRow]:
    """Train the perceiver's surface head in place on the first of ``episode_is``, watched on the
    second.

    Nothing else of the network changes. Returns the rows of its log; progress is kept in ``work``.
    """
    head, device = perceiver.net.surface, perceiver.device
    lessons = gather_objects(perceiver, source, shells, cfg, cfg.objects, episode_is[0])
    unseen = gather_objects(
        perceiver, source, shells, cfg, max(1, cfg.objects // 15), episode_is[1]
    )

    def batch_at(step: int) -> SurfaceBatch:
        generator = torch.Generator().manual_seed(cfg.fit.seed * 1_000_003 + step)
        chosen_P = torch.randint(len(lessons.mass_P3), (cfg.fit.batch,), generator=generator)
        by, flip = (
            torch.randint(lessons.radius_PRK.shape[-1] * 2, (1,), generator=generator).item(),
            2,
        )
        return rotate_lessons(lessons.pick(chosen_P), int(by) // flip, int(by) % flip == 1)

    def loss(net: nn.Module, batch: SurfaceBatch) -> Mapping[str, Tensor]:
        assert isinstance(net, SurfaceHead)
        return surface_losses(net, batch.to(device))

    def validate(net: nn.Module) -> Mapping[str, float]:
        assert isinstance(net, SurfaceHead)
        return surface_figures(net, unseen.pick(torch.arange(len(unseen.mass_P3))).to(device))

    with torch.enable_grad():
        rows = fit(head, batch_at, loss, dict.fromkeys(TERMS, 1.0), cfg.fit, work, device, validate)
    head.requires_grad_(True)
    return rows


def surface_losses(net: SurfaceHead, lessons: SurfaceBatch) -> dict[str, Tensor]:
    """``radius``: negative log-likelihood under a Laplace law where there is something;
    ``presence``: cross-entropy; ``mass``: distance of the centre of mass, 10 mm counting as 1.
    """
    found = net(lessons.inputs_PCKL)
    there_PRK = (lessons.radius_PRK > 0).float()
    rows_R1 = torch.ones(there_PRK.shape[1], 1, device=there_PRK.device)
    rows_R1[:LAYERS] = SUMMARY_WEIGHT
    weight_PRK = there_PRK * rows_R1
    apart_PRK = (found.radius_PRK - lessons.radius_PRK).abs() / found.scale_PRK + (
        found.scale_PRK / MM_10
    ).log()
    presence = F.binary_cross_entropy_with_logits(found.presence_PRK, there_PRK)
    return {
        "radius": (apart_PRK * weight_PRK).sum() / weight_PRK.sum(),
        "presence": presence,
        "mass": (found.mass_P3 - lessons.mass_P3).norm(dim=-1).mean() / MM_10,
    }


@torch.no_grad()
def surface_figures(net: SurfaceHead, lessons: SurfaceBatch) -> dict[str, float]:
    """Mean errors on objects not trained on: of the whole outline, the foot and the bands (mm), of
    presence (share wrong), of the centre of mass (mm).
    """
    parts = [net(lessons.inputs_PCKL[i : i + 64]) for i in range(0, len(lessons.mass_P3), 64)]
    radius_PRK = torch.cat([part.radius_PRK for part in parts])
    presence_PRK = torch.cat([part.presence_PRK for part in parts])
    mass_P3 = torch.cat([part.mass_P3 for part in parts])
    there_PRK = lessons.radius_PRK > 0
    apart_PRK = (radius_PRK - lessons.radius_PRK).abs() * 1e3
    rows = {
        "outline": slice(UNION, UNION + 1),
        "foot": slice(SUPPORT, SUPPORT + 1),
        "band": slice(LAYERS, None),
    }
    return {
        **{
            f"val_{name}_mm": float(apart_PRK[:, row][there_PRK[:, row]].mean())
            for name, row in rows.items()
        },
        "val_presence": float(((presence_PRK > 0) != there_PRK).float().mean()),
        "val_mass_mm": float((mass_P3 - lessons.mass_P3).norm(dim=-1).mean()) * 1e3,
    }
