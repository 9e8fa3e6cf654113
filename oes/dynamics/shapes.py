"""Completed surfaces as dynamics carries them: outlines, masses and what of them is uncertain, as
one flat vector.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from oes.config import params
from oes.dynamics.rigid_body.bodies import RigidBodies
from oes.geom.boxes import base
from oes.geom.polar import directions
from oes.objects import LAYERS, SUPPORT, UNION, UPPER, Objects

MIN_PRESENCE = 0.1  # what may be there is: through what is wrongly left out, a rod passes and an object falls over
SECTORS = 16
MIN_GYRATION_M = 0.01
MIN_HEIGHT_M = 0.003
OUTEST_M = 0.002  # how far within the outline of all bands one may be to count as reaching it
LAPLACE_SD = 2**0.5
NUMBERS, DRAWN = 7, 5


@params
class ShapeUncertainty:
    """How the futures of one scene differ: their number, and standard deviations of what differs
    between them: outlines (in units of their own scale) by so many waves around, centres of mass
    (metres), mass and friction (log).
    """

    draws: int
    outline: float
    waves: int
    mass_m: float
    log_mass: float
    log_friction: float


@dataclass(frozen=True)
class ObjectShapes:
    """Surfaces of N objects of B scenes at t = 0: radii (0 where nothing is thought to be), their
    scales and presences BNRK, the centre of mass from the reference point BN3, mass and friction as
    multiples of the usual BN, how far below the reference point the lowest band begins BN, and how
    tall they are BN (metres).
    """

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
        return torch.cat(
            [*(row.flatten(2) for row in rows), self.mass_BN3, torch.stack(numbers, -1)], -1
        )

    def sample(self, cfg: ShapeUncertainty, generator: torch.Generator) -> "ObjectShapes":
        """The objects as they seem and, after them, as they might be instead: (DB)N of
        ``cfg.draws`` draws.

        Within a draw all objects are off in the same way (in the world's axes), so that their
        number and order change nothing. ``generator`` is the CPU's.
        """
        draws, batch, count = cfg.draws, len(self.heavy_BN), self.radius_BNRK.shape[-1]
        wave_DK, numbers_D5 = (
            _fourier_noise(draws, count, cfg.waves, generator),
            torch.randn(draws, DRAWN, generator=generator),
        )
        wave_DK[0], numbers_D5[0] = 0, 0
        wave_CK, numbers_C5 = (
            wave_DK.repeat_interleave(batch, 0),
            numbers_D5.repeat_interleave(batch, 0)[:, None],
        )
        all_C = ObjectShapes(
            **{name: x.repeat(draws, *[1] * (x.ndim - 1)) for name, x in vars(self).items()}
        )
        shift_CNRK = wave_CK[:, None, None] * all_C.scale_BNRK * (cfg.outline * LAPLACE_SD)
        radius_CNRK = (all_C.radius_BNRK + shift_CNRK).clamp(min=1e-3)
        return replace(
            all_C,
            radius_BNRK=torch.where(all_C.radius_BNRK > 0, radius_CNRK, all_C.radius_BNRK),
            mass_BN3=all_C.mass_BN3 + numbers_C5[..., :3] * cfg.mass_m,
            heavy_BN=all_C.heavy_BN * (numbers_C5[..., 3] * cfg.log_mass).exp(),
            rough_BN=all_C.rough_BN * (numbers_C5[..., 4] * cfg.log_friction).exp(),
        )

    def bodies(self, valid_BN: Tensor, band_m: float) -> RigidBodies:
        """What slides; bands of the outlines are ``band_m`` high."""
        height_BN = (self.mass_BN3[..., 2] + self.foot_BN).clamp(min=MIN_HEIGHT_M)
        low_BNK, high_BNK = self._beside(band_m)
        return RigidBodies(
            rod_BNK=self.radius_BNRK[:, :, UPPER],
            whole_BNK=self.radius_BNRK[:, :, UNION],
            mass_BN2=self.mass_BN3[..., :2],
            feet_BNM2=self._feet(),
            height_BN=height_BN,
            rod_low_BNK=low_BNK - height_BN[..., None],
            rod_high_BNK=high_BNK - height_BN[..., None],
            inverse_BN33=self._inverse(),
            tall_BN=self.tall_BN,
            heavy_BN=self.heavy_BN,
            rough_BN=self.rough_BN,
            valid_BN=valid_BN,
        )

    def _feet(self) -> Tensor:
        """The farthest point of the foot (the lowest band, where none is seen) in each of some
        sectors, BNM2, from the centre of mass.
        """
        foot_BNK, lowest_BNK = self.radius_BNRK[:, :, SUPPORT], self.radius_BNRK[:, :, LAYERS]
        foot_BNK = torch.where((foot_BNK > 0).any(-1, keepdim=True), foot_BNK, lowest_BNK)
        far_BNS, k_BNS = foot_BNK.reshape(*foot_BNK.shape[:-1], SECTORS, -1).max(-1)
        first_S = torch.arange(SECTORS) * (foot_BNK.shape[-1] // SECTORS)
        side_BNS2 = directions(foot_BNK.shape[-1])[k_BNS + first_S]
        feet_BNS2: Tensor = side_BNS2 * far_BNS[..., None] - self.mass_BN3[..., None, :2]
        return feet_BNS2

    def _beside(self, band_m: float) -> tuple[Tensor, Tensor]:
        """Between which heights BNK above the foot the outline that the rod meets is reached."""
        bands_BNBK, above_BNK = self.radius_BNRK[:, :, LAYERS:], self.radius_BNRK[:, :, UPPER]
        floor_B1 = torch.arange(bands_BNBK.shape[2])[:, None] * band_m
        is_out = bands_BNBK > above_BNK[:, :, None] - OUTEST_M
        low_BNK = torch.where(is_out, floor_B1, 1.0).amin(2)
        high_BNK = torch.where(is_out, floor_B1 + band_m, 0.0).amax(2)
        tall_BN1 = self.tall_BN[..., None]
        return low_BNK.minimum(tall_BN1), high_BNK.minimum(tall_BN1)

    def _inverse(self) -> Tensor:
        """Inverse inertia BN33 for a mass of 1, of prisms of the outlines about their middles."""
        radius_BNK = self.radius_BNRK[:, :, UNION].clamp(min=MIN_GYRATION_M)
        side_K2 = directions(radius_BNK.shape[-1])
        area_BN = radius_BNK.square().mean(-1) / 2
        first_BN2 = (radius_BNK**3 / 3)[..., None].mul(side_K2).mean(2) / area_BN[..., None]
        outer_K22 = side_K2[:, :, None] * side_K2[:, None]
        second_BN22 = (radius_BNK**4 / 4)[..., None, None].mul(outer_K22).mean(2) / area_BN[
            ..., None, None
        ]
        moment_BN33 = torch.zeros(*area_BN.shape, 3, 3)
        moment_BN33[..., :2, :2] = second_BN22 - first_BN2[..., None] * first_BN2[..., None, :]
        moment_BN33[..., 2, 2] = self.tall_BN.clamp(min=MIN_GYRATION_M) ** 2 / 12
        total_BN11 = moment_BN33.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
        inverse_BN33: Tensor = torch.linalg.inv(total_BN11 * torch.eye(3) - moment_BN33)
        return inverse_BN33


def shapes_of(objects: Objects) -> ObjectShapes:
    """The surfaces of batched objects as first seen."""
    radius, scale, presence = objects.radial_profile_NRD3.unbind(-1)
    height_BN, tall_BN = objects.center_N3[..., 2], objects.size_N3[..., 2]
    usual_BN = torch.ones_like(height_BN)
    foot_BN = height_BN - base(objects.center_N3, objects.size_N3)
    seen = radius * (presence > MIN_PRESENCE), scale, presence
    return ObjectShapes(*seen, objects.com_offset_N3, usual_BN, usual_BN, foot_BN, tall_BN)


def unpacked(appearance_BNC: Tensor, rows: int, count: int) -> ObjectShapes:
    """What ``ObjectShapes.packed`` made, of ``rows`` outlines in ``count`` directions."""
    parts, numbers_BN7 = appearance_BNC[..., :-NUMBERS], appearance_BNC[..., -NUMBERS:]
    radius, scale, presence = parts.reshape(*parts.shape[:-1], 3, rows, count).unbind(2)
    return ObjectShapes(
        radius, scale, presence, numbers_BN7[..., :3], *numbers_BN7[..., 3:].unbind(-1)
    )


def _fourier_noise(num: int, count: int, waves: int, generator: torch.Generator) -> Tensor:
    """``num`` random smooth functions of direction, DK, of mean square 1: a constant and ``waves``
    harmonics.
    """
    angle_K = torch.arange(count) * (2 * math.pi / count)
    turns_W1 = torch.arange(1, waves + 1)[:, None]
    basis = [
        torch.ones(1, count),
        2**0.5 * (turns_W1 * angle_K).cos(),
        2**0.5 * (turns_W1 * angle_K).sin(),
    ]
    basis_FK = torch.cat(basis)
    weight_DF = torch.randn(num, len(basis_FK), generator=generator) / math.sqrt(len(basis_FK))
    return weight_DF @ basis_FK
