"""Completed surfaces in dynamics: radial profiles, mass properties and their uncertainty."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from oes.config import params
from oes.dynamics.rigid_body.bodies import RigidBodies
from oes.geom.boxes import support_height
from oes.geom.polar import directions
from oes.objects import LAYERS, SUPPORT, UNION, UPPER, Objects, map_tensors

# Low on purpose: a missing surface lets the rod pass through and lets an object fall over, which
# is the worse error.
MIN_PRESENCE = 0.1
NUM_SUPPORTS = 16
MIN_GYRATION_M = 0.01
MIN_COM_HEIGHT_M = 0.003
MIN_RADIUS_M = 1e-3
OUTERMOST_M = 0.002  # a layer this close to the outermost one counts as reaching as far
LAPLACE_STD = 2**0.5  # standard deviation of a Laplace distribution of scale 1
NUM_SCALARS = 7


@params
class ShapeUncertainty:
    """Number of sampled futures, and standard deviations of their perturbations.

    ``radius_sigma``: of the radii, in units of their predicted scale, as a Fourier series of
    ``harmonics``; ``com_sigma_m``: of the centre of mass; the rest: of the logarithms.
    """

    num_samples: int
    radius_sigma: float
    harmonics: int
    com_sigma_m: float
    log_mass_sigma: float
    log_friction_sigma: float


@dataclass(frozen=True)
class ObjectShapes:
    """Surfaces and mass properties of N objects at t = 0.

    Profiles around the vertical through the reference point (see ``oes.objects``): ``radius_BNRD``
    (metres, 0 where there is no surface), its predicted scale ``sigma_BNRD`` (metres) and its
    existence probability ``presence_BNRD``. ``com_BN3``: centre of mass from the reference point.
    ``mass_factor_BN``, ``friction_factor_BN``: multiples of the nominal values.
    ``support_depth_BN``: height of the reference point above the object's lowest point.
    """

    radius_BNRD: Tensor
    sigma_BNRD: Tensor
    presence_BNRD: Tensor
    com_BN3: Tensor
    mass_factor_BN: Tensor
    friction_factor_BN: Tensor
    support_depth_BN: Tensor
    height_BN: Tensor

    def pack(self) -> Tensor:
        """One vector per object, BNC; the inverse of ``unpack_shapes``."""
        profiles = torch.stack([self.radius_BNRD, self.sigma_BNRD, self.presence_BNRD], 2)
        factors = [self.mass_factor_BN, self.friction_factor_BN]
        scalars = torch.stack([*factors, self.support_depth_BN, self.height_BN], -1)
        return torch.cat([profiles.flatten(2), self.com_BN3, scalars], -1)

    def sample(self, cfg: ShapeUncertainty, generator: torch.Generator) -> "ObjectShapes":
        """``cfg.num_samples`` samples one after the other; the first is the unchanged input.

        All objects of a sample share one perturbation (in world axes), so that forecasts depend on
        neither the number nor the order of objects. ``generator`` is on the CPU.
        """
        samples, batch = cfg.num_samples, len(self.com_BN3)
        noise_MD = _fourier_noise(samples, self.radius_BNRD.shape[-1], cfg.harmonics, generator)
        normal_M5 = torch.randn(samples, 5, generator=generator)
        # Sample 0 stays as perceived.
        noise_MD[0], normal_M5[0] = 0, 0
        noise = noise_MD.repeat_interleave(batch, 0)[:, None, None]
        normal = normal_M5.repeat_interleave(batch, 0)[:, None]
        x = map_tensors(self, lambda t: torch.cat([t] * samples))
        shift = noise * x.sigma_BNRD * (cfg.radius_sigma * LAPLACE_STD)
        radius = (x.radius_BNRD + shift).clamp(min=MIN_RADIUS_M)
        mass, friction = x.mass_factor_BN, x.friction_factor_BN
        return replace(
            x,
            radius_BNRD=torch.where(x.radius_BNRD > 0, radius, x.radius_BNRD),
            com_BN3=x.com_BN3 + normal[..., :3] * cfg.com_sigma_m,
            mass_factor_BN=mass * (normal[..., 3] * cfg.log_mass_sigma).exp(),
            friction_factor_BN=friction * (normal[..., 4] * cfg.log_friction_sigma).exp(),
        )

    def bodies(self, valid_BN: Tensor, layer_height_m: float) -> RigidBodies:
        """Rigid bodies of these shapes; the profiles' layers are ``layer_height_m`` high."""
        com_height_BN = (self.com_BN3[..., 2] + self.support_depth_BN).clamp(min=MIN_COM_HEIGHT_M)
        low_BND, high_BND = self._outermost_heights(layer_height_m)
        return RigidBodies(
            rod_profile_BND=self.radius_BNRD[:, :, UPPER],
            profile_BND=self.radius_BNRD[:, :, UNION],
            com_offset_BN2=self.com_BN3[..., :2],
            support_BNP2=self._support_points(),
            com_height_BN=com_height_BN,
            rod_min_z_BND=low_BND - com_height_BN[..., None],
            rod_max_z_BND=high_BND - com_height_BN[..., None],
            inverse_inertia_BN33=self._inverse_inertia(),
            height_BN=self.height_BN,
            mass_factor_BN=self.mass_factor_BN,
            friction_factor_BN=self.friction_factor_BN,
            valid_BN=valid_BN,
        )

    def _support_points(self) -> Tensor:
        """Farthest support point BNP2 of each sector, from the centre of mass.

        Where no support is predicted, the lowest layer takes its place.
        """
        support_BND, lowest_BND = self.radius_BNRD[:, :, SUPPORT], self.radius_BNRD[:, :, LAYERS]
        support_BND = torch.where((support_BND > 0).any(-1, keepdim=True), support_BND, lowest_BND)
        num = support_BND.shape[-1]
        radius_BNP, i_BNP = torch.unflatten(support_BND, -1, (NUM_SUPPORTS, -1)).max(-1)
        first_P = torch.arange(NUM_SUPPORTS) * (num // NUM_SUPPORTS)
        points_BNP2: Tensor = directions(num)[i_BNP + first_P] * radius_BNP[..., None]
        return points_BNP2 - self.com_BN3[..., None, :2]

    def _outermost_heights(self, layer_height_m: float) -> tuple[Tensor, Tensor]:
        """Lowest and highest heights BND, above the support, where the rod meets the object."""
        layers_BNRD, upper_BND = self.radius_BNRD[:, :, LAYERS:], self.radius_BNRD[:, :, UPPER]
        bottom_R1 = torch.arange(layers_BNRD.shape[2])[:, None] * layer_height_m
        is_outermost = layers_BNRD > upper_BND[:, :, None] - OUTERMOST_M
        low_BND = torch.where(is_outermost, bottom_R1, 1.0).amin(2)
        high_BND = torch.where(is_outermost, bottom_R1 + layer_height_m, 0.0).amax(2)
        height_BN1 = self.height_BN[..., None]
        return low_BND.minimum(height_BN1), high_BND.minimum(height_BN1)

    def _inverse_inertia(self) -> Tensor:
        """Inverse inertia BN33, for a mass of 1, of the prism over ``UNION`` about its centroid."""
        radius = self.radius_BNRD[:, :, UNION].clamp(min=MIN_GYRATION_M)
        ray_D2 = directions(radius.shape[-1])
        # Integrals over the area in polar coordinates: r^2/2, r^3/3 and r^4/4 per direction.
        area_BN1 = (radius.square().mean(-1) / 2)[..., None]
        mean_BN2 = (radius**3 / 3)[..., None].mul(ray_D2).mean(2) / area_BN1
        outer_D22 = ray_D2[:, :, None] * ray_D2[:, None]
        second_BN22 = (radius**4 / 4)[..., None, None].mul(outer_D22).mean(2) / area_BN1[..., None]
        covariance = torch.zeros(*radius.shape[:2], 3, 3)
        covariance[..., :2, :2] = second_BN22 - mean_BN2[..., None] * mean_BN2[..., None, :]
        covariance[..., 2, 2] = self.height_BN.clamp(min=MIN_GYRATION_M) ** 2 / 12
        trace_BN11 = covariance.diagonal(dim1=-2, dim2=-1).sum(-1)[..., None, None]
        inverse_BN33: Tensor = torch.linalg.inv(trace_BN11 * torch.eye(3) - covariance)
        return inverse_BN33


def shapes_of(objects: Objects) -> ObjectShapes:
    """Shapes of batched objects in the first frame, with nominal mass and friction."""
    radius, sigma, presence = objects.radial_profile_NRD3.unbind(-1)
    z_BN = objects.center_N3[..., 2]
    return ObjectShapes(
        radius_BNRD=radius * (presence > MIN_PRESENCE),
        sigma_BNRD=sigma,
        presence_BNRD=presence,
        com_BN3=objects.com_offset_N3,
        mass_factor_BN=torch.ones_like(z_BN),
        friction_factor_BN=torch.ones_like(z_BN),
        support_depth_BN=z_BN - support_height(objects.center_N3, objects.size_N3),
        height_BN=objects.size_N3[..., 2],
    )


def unpack_shapes(appearance_BNC: Tensor, rows: int, num_directions: int) -> ObjectShapes:
    """Inverse of ``ObjectShapes.pack`` for profiles of ``rows`` x ``num_directions``."""
    profiles, scalars = appearance_BNC[..., :-NUM_SCALARS], appearance_BNC[..., -NUM_SCALARS:]
    radius, sigma, presence = torch.unflatten(profiles, -1, (3, rows, num_directions)).unbind(2)
    return ObjectShapes(radius, sigma, presence, scalars[..., :3], *scalars[..., 3:].unbind(-1))


def _fourier_noise(num: int, count: int, harmonics: int, generator: torch.Generator) -> Tensor:
    """``num`` random periodic functions of ``count`` directions, of mean square 1."""
    angle_D = torch.arange(count) * (2 * math.pi / count)
    phase_CD = torch.arange(1, harmonics + 1)[:, None] * angle_D
    # A factor of sqrt 2 gives every basis function a mean square of 1.
    sines = 2**0.5 * phase_CD.cos(), 2**0.5 * phase_CD.sin()
    basis_CD = torch.cat([torch.ones(1, count), *sines])
    weight_MC = torch.randn(num, len(basis_CD), generator=generator) / math.sqrt(len(basis_CD))
    return weight_MC @ basis_CD
