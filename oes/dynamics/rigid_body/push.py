"""One action of the rod on rigid bodies: from torch tensors to the compiled kernels and back."""

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from oes.dynamics.rigid_body.bodies import ContactPhysics, PlanarState, RigidBodies
from oes.dynamics.rigid_body.constraints import empty_rows
from oes.dynamics.rigid_body.contact_detection import detect_table
from oes.dynamics.rigid_body.contact_manifold import empty_manifold, update_manifold
from oes.dynamics.rigid_body.kernels import Bodies, State, StepSettings
from oes.dynamics.rigid_body.substeps import advance_substeps
from oes.episode import Floats
from oes.geom.polar import profile_normals, profile_points
from oes.objects import map_tensors

BREAKING = 0.02  # breaking distance of a contact over the bounding radius, as in Bullet
ROD_RADIUS_M = 0.075  # bounding radius of the rod
MIN_SPEED_M_S = 1e-6
MIN_SCENES = 16  # per thread
PLANAR = [0, 1, 5]  # components of a 6D twist that lie in the plane


def simulate_push(
    bodies: RigidBodies, state: PlanarState, tip_B2: Tensor, action_B2: Tensor, cfg: ContactPhysics
) -> PlanarState:
    """State after the rod's tip has moved from ``tip_B2`` by ``action_B2`` (metres).

    No gradient flows through it. Scenes are divided among torch's threads; their number does not
    change the result.
    """
    count = max(1, min(torch.get_num_threads(), len(tip_B2) // MIN_SCENES))
    bounds = [len(tip_B2) * i // count for i in range(count + 1)]
    # Gauss-Seidel depends on the order of contacts. Sorting objects along the push makes the result
    # independent of the order in which they are listed.
    ahead_BN = (state.com_BN2 * action_B2[:, None]).sum(-1)
    ahead_BN = ahead_BN.masked_fill(~bodies.valid_BN, torch.inf)
    order_BN = ahead_BN.argsort(dim=-1, stable=True)
    back_BN, scene_B1 = order_BN.argsort(-1), torch.arange(len(order_BN))[:, None]
    bodies = map_tensors(bodies, lambda x: x[scene_B1, order_BN])
    state = map_tensors(state, lambda x: x[scene_B1, order_BN])

    def run(part: slice) -> PlanarState:
        part_bodies = map_tensors(bodies, lambda x: x[part])
        start = map_tensors(state, lambda x: x[part])
        return _simulate(part_bodies, start, tip_B2[part], action_B2[part], cfg)

    with ThreadPoolExecutor(count) as pool:
        first, *others = pool.map(run, [slice(*ends) for ends in pairwise(bounds)])
    after = map_tensors(first, lambda *parts: torch.cat(parts), *others)
    return map_tensors(after, lambda x: x[scene_B1, back_BN])


def _simulate(
    bodies: RigidBodies, start: PlanarState, tip_B2: Tensor, action_B2: Tensor, cfg: ContactPhysics
) -> PlanarState:
    """As ``simulate_push``, in one thread."""
    state = _upright_state(bodies, start)
    planar_BN3 = _advance(bodies, state, _array(tip_B2), _array(action_B2) / cfg.step_s, cfg)
    com_BN2, yaw_BN, twist_BN3 = (
        torch.from_numpy(x).to(start.com_BN2)
        for x in (planar_BN3[..., :2], planar_BN3[..., 2], state.twist_BN6[..., PLANAR])
    )
    # Unwrap: the yaw continues from the start, beyond +-pi.
    turn_BN = torch.remainder(yaw_BN - start.yaw_BN + torch.pi, 2 * torch.pi)
    yaw_BN = start.yaw_BN + turn_BN - torch.pi
    return PlanarState(
        torch.where(bodies.valid_BN[..., None], com_BN2, start.com_BN2),
        torch.where(bodies.valid_BN, yaw_BN, start.yaw_BN),
        twist_BN3 * bodies.valid_BN[..., None],
    )


def _upright_state(bodies: RigidBodies, start: PlanarState) -> State:
    """Bodies upright on the table; those without velocity are asleep."""
    com_BN3 = _array(torch.cat([start.com_BN2, bodies.com_height_BN[..., None]], -1))
    yaw_BN = _array(start.yaw_BN)
    rotation_BN33, twist_BN6 = np.zeros((*yaw_BN.shape, 3, 3)), np.zeros((*yaw_BN.shape, 6))
    rotation_BN33[..., 0, 0] = rotation_BN33[..., 1, 1] = np.cos(yaw_BN)
    rotation_BN33[..., 1, 0], rotation_BN33[..., 0, 1] = np.sin(yaw_BN), -np.sin(yaw_BN)
    rotation_BN33[..., 2, 2] = 1
    twist_BN6[..., PLANAR] = _array(start.twist_BN3)
    return State(com_BN3, rotation_BN33, twist_BN6, (twist_BN6 != 0).any(-1))


def _advance(
    rigid: RigidBodies, state: State, tip_B2: Floats, velocity_B2: Floats, cfg: ContactPhysics
) -> Floats:
    """Advance ``state`` by one action; planar poses BN3 (x, y, yaw)."""
    bodies, friction_BN = compile_bodies(rigid, cfg), _array(rigid.friction_factor_BN)
    breaking_BN = BREAKING * np.hypot(bodies.radius_BN, bodies.height_BN / 2)
    rod_breaking_BN = np.minimum(breaking_BN, BREAKING * ROD_RADIUS_M)
    zero_B1 = np.zeros((len(tip_B2), 1))
    table = empty_manifold(
        np.tile(zero_B1, 3), np.tile(zero_B1, 2), friction_BN * cfg.table_friction, breaking_BN
    )
    rod_B3 = np.concatenate([tip_B2, zero_B1], 1)
    rod = empty_manifold(rod_B3, velocity_B2, friction_BN * cfg.rod_friction, rod_breaking_BN)
    speed_B1 = np.hypot(velocity_B2[:, :1], velocity_B2[:, 1:])
    forward_B2 = velocity_B2 / np.maximum(speed_B1, MIN_SPEED_M_S)
    left_B2 = np.stack([-forward_B2[:, 1], forward_B2[:, 0]], 1)
    # At rest a body stands on four support points; detection finds one per side.
    for side_B2 in (forward_B2, -forward_B2, left_B2, -left_B2):
        update_manifold(table, detect_table(bodies, state, side_B2, bodies.is_valid_BN), state)
    settings = StepSettings(
        dt=cfg.step_s / cfg.substeps,
        substeps=cfg.substeps,
        iterations=cfg.solver_iterations,
        spinning_m=cfg.spinning_friction_m,
        rod_radius_m=cfg.rod_radius_m + cfg.contact_margin_m,
        tip_height_m=cfg.tip_height_m,
        margin_m=cfg.contact_margin_m,
    )
    rows = empty_rows(friction_BN.shape[1])
    return advance_substeps(bodies, state, (table, rod), rows, forward_B2, settings)


def compile_bodies(bodies: RigidBodies, cfg: ContactPhysics) -> Bodies:
    """Bodies as arrays for the kernels, with everything that follows from their profiles."""
    rod_vertex_BND2, vertex_BND2 = (
        profile_points(profile) - bodies.com_offset_BN2[..., None, :]
        for profile in (bodies.rod_profile_BND, bodies.profile_BND)
    )
    radius_BND = torch.maximum(rod_vertex_BND2.norm(dim=-1), vertex_BND2.norm(dim=-1))
    support_z_BN11 = -bodies.com_height_BN[..., None, None]
    support_z_BNP1 = support_z_BN11.expand(*bodies.support_BNP2.shape[:-1], 1)
    has_rod_BN = bodies.valid_BN & (bodies.rod_profile_BND > 0).any(-1)
    shared = {name: _array(x) for name, x in vars(bodies).items() if name in Bodies._fields}
    return Bodies(
        **shared,
        rod_vertex_BND2=_array(rod_vertex_BND2),
        vertex_BND2=_array(vertex_BND2),
        normal_BND2=_array(profile_normals(bodies.profile_BND)),
        radius_BN=_array(radius_BND.amax(-1)),
        support_BNP3=_array(torch.cat([bodies.support_BNP2, support_z_BNP1], -1)),
        mass_BN=_array(bodies.mass_factor_BN),
        pair_friction_BN=_array(bodies.friction_factor_BN) * cfg.object_friction,
        is_valid_BN=bodies.valid_BN.cpu().numpy().copy(),
        has_rod_BN=has_rod_BN.cpu().numpy(),
    )


def _array(x: Tensor) -> Floats:
    """A double-precision copy, which kernels may change."""
    return x.double().cpu().contiguous().numpy().copy()
