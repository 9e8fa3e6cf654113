"""Completed surfaces as dynamics carries them: outlines, masses and what of them is uncertain, as one flat vector."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from oes.config import params
from oes.dynamics.bodies import Bodies, Physics
from oes.geom.polar import directions, gyration
from oes.objects import Objects

WHOLE, ABOVE, BANDS = 0, 1, 2  # rows of an outline, as perception orders them (``oes.percept.surface``)
THERE = 0.5
SECTORS = 16
LEAST_GYRATION_M = 0.01
LAPLACE_SD = 2**0.5
NUMBERS, DRAWN = 7, 5


@params
class Doubt:
    """How the futures of one scene differ: their number, and standard deviations of what differs between them: outlines
    (in units of their own scale) by so many waves around, centres of mass (metres), mass and friction (log)."""

    draws: int
    outline: float
    waves: int
    mass_m: float
    log_mass: float
    log_friction: float


@dataclass(frozen=True)
class Shapes:
    """Surfaces of N objects of B scenes at t = 0: radii (0 where nothing is thought to be), their scales and presences
    BNRK, the centre of mass from the reference point BN3, mass and friction as multiples of the usual BN, how far below
    the reference point the lowest band begins BN, and how tall they are BN (metres)."""

    radius_BNRK: Tensor
    scale_BNRK: Tensor
    presence_BNRK: Tensor
    mass_BN3: Tensor
    heavy_BN: Tensor
    rough_BN: Tensor
    foot_BN: Tensor
    tall_BN: Tensor

    def packed(self) -> Tensor:
        """BNC, for ``unpacked``."""
        rows = [self.radius_BNRK, self.scale_BNRK, self.presence_BNRK]
        numbers = [self.heavy_BN, self.rough_BN, self.foot_BN, self.tall_BN]
        return torch.cat([*(row.flatten(2) for row in rows), self.mass_BN3, torch.stack(numbers, -1)], -1)

    def redrawn(self, cfg: Doubt, generator: torch.Generator) -> "Shapes":
        """The objects as they seem and, after them, as they might be instead: (DB)N of ``cfg.draws`` draws.

        Within a draw all objects are off in the same way (in the world's axes), so that their number and order change
        nothing. ``generator`` is the CPU's.
        """
        draws, batch, count = cfg.draws, len(self.heavy_BN), self.radius_BNRK.shape[-1]
        wave_DK, numbers_D5 = _waves(draws, count, cfg.waves, generator), torch.randn(draws, DRAWN, generator=generator)
        wave_DK[0], numbers_D5[0] = 0, 0
        wave_CK, numbers_C5 = wave_DK.repeat_interleave(batch, 0), numbers_D5.repeat_interleave(batch, 0)[:, None]
        all_C = Shapes(**{name: x.repeat(draws, *[1] * (x.ndim - 1)) for name, x in vars(self).items()})
        shift_CNRK = wave_CK[:, None, None] * all_C.scale_BNRK * (cfg.outline * LAPLACE_SD)
        radius_CNRK = (all_C.radius_BNRK + shift_CNRK).clamp(min=1e-3)
        return replace(
            all_C,
            radius_BNRK=torch.where(all_C.radius_BNRK > 0, radius_CNRK, all_C.radius_BNRK),
            mass_BN3=all_C.mass_BN3 + numbers_C5[..., :3] * cfg.mass_m,
            heavy_BN=all_C.heavy_BN * (numbers_C5[..., 3] * cfg.log_mass).exp(),
            rough_BN=all_C.rough_BN * (numbers_C5[..., 4] * cfg.log_friction).exp(),
        )

    def bodies(self, valid_BN: Tensor, cfg: Physics) -> Bodies:
        """What slides."""
        mass_BN2 = self.mass_BN3[..., :2]
        foot_BNSK = self.radius_BNRK[:, :, BANDS].reshape(*self.heavy_BN.shape, SECTORS, -1)
        far_BNS, k_BNS = foot_BNSK.max(-1)
        side_K2 = directions(self.radius_BNRK.shape[-1])
        side_BNS2 = side_K2[k_BNS + torch.arange(SECTORS) * foot_BNSK.shape[-1]]
        there_BNS = (far_BNS > 0).float()
        return Bodies(
            rod_BNK=self.radius_BNRK[:, :, ABOVE],
            whole_BNK=self.radius_BNRK[:, :, WHOLE],
            support_BNM2=side_BNS2 * (far_BNS * cfg.stance)[..., None] - mass_BN2[..., None, :],
            share_BNM=there_BNS / there_BNS.sum(-1, keepdim=True).clamp(min=1),
            mass_BN2=mass_BN2,
            gyration_BN=gyration(self.radius_BNRK[:, :, WHOLE]).clamp(min=LEAST_GYRATION_M) * cfg.gyration,
            heavy_BN=self.heavy_BN,
            rough_BN=self.rough_BN,
            valid_BN=valid_BN,
        )


def shapes_of(objects: Objects) -> Shapes:
    """The surfaces of batched objects as first seen."""
    radius, scale, presence = objects.outline_NRK3.unbind(-1)
    height_BN, tall_BN = objects.center_N3[..., 2], objects.size_N3[..., 2]
    usual_BN = torch.ones_like(height_BN)
    foot_BN = (tall_BN / 2).minimum(height_BN)  # as perception puts it: never below the table
    seen = radius * (presence > THERE), scale, presence
    return Shapes(*seen, objects.mass_N3, usual_BN, usual_BN, foot_BN, tall_BN)


def unpacked(appearance_BNC: Tensor, rows: int, count: int) -> Shapes:
    """What ``Shapes.packed`` made, of ``rows`` outlines in ``count`` directions."""
    parts, numbers_BN7 = appearance_BNC[..., :-NUMBERS], appearance_BNC[..., -NUMBERS:]
    radius, scale, presence = parts.reshape(*parts.shape[:-1], 3, rows, count).unbind(2)
    return Shapes(radius, scale, presence, numbers_BN7[..., :3], *numbers_BN7[..., 3:].unbind(-1))


def _waves(num: int, count: int, waves: int, generator: torch.Generator) -> Tensor:
    """``num`` random smooth functions of direction, DK, of mean square 1: a constant and ``waves`` harmonics."""
    angle_K = torch.arange(count) * (2 * math.pi / count)
    turns_W1 = torch.arange(1, waves + 1)[:, None]
    basis = [torch.ones(1, count), 2**0.5 * (turns_W1 * angle_K).cos(), 2**0.5 * (turns_W1 * angle_K).sin()]
    basis_FK = torch.cat(basis)
    weight_DF = torch.randn(num, len(basis_FK), generator=generator) / math.sqrt(len(basis_FK))
    return weight_DF @ basis_FK
