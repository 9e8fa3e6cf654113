"""Object graph network shared by all learned models (paper section 3.2, appendix C.1)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from oes.config import params

NOWHERE_M = 1e3  # coordinate of an absent tip or surface: far from every object


@params
class GraphConfig:
    """Width and depth of every MLP, rounds of message passing, and the inputs of a node.

    ``unit_m`` is the length that the network sees as 1. ``angular_velocity`` adds the last
    rotation to the inputs: falling objects keep spinning.
    """

    width: int
    layers: int
    rounds: int
    unit_m: float
    angular_velocity: bool


@dataclass(frozen=True)
class ObjectState:
    """State of N objects, in world axes and metres.

    ``center_BN3``: reference point, which is the box centre at t = 0 and then moves with the
    object; ``velocity_BN3`` and ``omega_BN3``: its displacement and rotation vector over the last
    step; ``displacement_BN3`` and ``rotation_BN33``: motion since t = 0; ``twist_BN3``: planar
    velocity (m/s, m/s, rad/s) in models that simulate sliding, else 0.
    """

    center_BN3: Tensor
    velocity_BN3: Tensor
    omega_BN3: Tensor
    displacement_BN3: Tensor
    rotation_BN33: Tensor
    twist_BN3: Tensor
    valid_BN: Tensor


@dataclass(frozen=True)
class TipMotion:
    """One action: the robot's tip moves from ``start_B3`` by ``action_B3`` (world, metres).

    A start of NaN stands for a scene without a robot.
    """

    start_B3: Tensor
    action_B3: Tensor

    def axes_B33(self) -> Tensor:
        """``world_R_action``: x along the horizontal action (the world's x if 0), z up."""
        return yaw_rotation(torch.atan2(self.action_B3[:, 1], self.action_B3[:, 0]))

    def finite_start_B3(self) -> Tensor:
        """The start; ``NOWHERE_M`` without a robot."""
        return self.start_B3.nan_to_num(nan=NOWHERE_M)


@dataclass(frozen=True)
class StepMotion:
    """Motion over one step: displacement (metres) and rotation vector, in world axes.

    ``twist_BN3``: planar velocity after the step (see ``ObjectState``).
    """

    dp_BN3: Tensor
    rotvec_BN3: Tensor
    twist_BN3: Tensor | None = None


@dataclass(frozen=True)
class GraphFeatures:
    """Encoded shapes at one step, in the action's axes; widths may be 0.

    ``node_BNC``: features of each object; ``agent_BNC``: of the edge from the tip to each object;
    ``edge_BNNC``: of the edge to each receiver (first N) from each sender.
    """

    node_BNC: Tensor
    agent_BNC: Tensor
    edge_BNNC: Tensor


class GraphNet(nn.Module):
    """Nodes are the objects and the tip; every object receives edges from all other nodes.

    All vectors are expressed in axes whose x points along the action, so that forecasts are
    equivariant to rotations about the vertical.
    """

    NODE_GEOMETRY = 10  # velocity, displacement since t = 0, vertical axis, height above the table
    AGENT_GEOMETRY = 6  # the tip's position from the object, the action
    EDGE_GEOMETRY = 3  # the sender's position from the receiver

    def __init__(self, cfg: GraphConfig, node_width: int, edge_width: int = 0) -> None:
        """``node_width``, ``edge_width``: of ``GraphFeatures``; both kinds of edges are alike."""
        super().__init__()
        self.unit_m, self.angular_velocity = cfg.unit_m, cfg.angular_velocity
        node = node_width + self.NODE_GEOMETRY + 3 * cfg.angular_velocity
        edge = edge_width + self.EDGE_GEOMETRY
        size = cfg.width, cfg.layers
        self.agent_edge = mlp(node + edge_width + self.AGENT_GEOMETRY, *size)
        hidden = [node] + [cfg.width] * (cfg.rounds - 1)
        self.edges = nn.ModuleList(mlp(2 * inputs + edge, *size) for inputs in hidden)
        self.nodes = nn.ModuleList(mlp(node + 2 * cfg.width, *size) for _ in hidden)
        self.head = nn.Linear(cfg.width, 6)
        # A small gain makes the untrained network forecast almost no motion.
        nn.init.xavier_uniform_(self.head.weight, gain=0.1)
        nn.init.zeros_(self.head.bias)

    def forward(self, features: GraphFeatures, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Motion of every object over one action."""
        axes_B133, unit_m = tip.axes_B33()[:, None], self.unit_m
        vectors = [state.velocity_BN3 / unit_m, state.displacement_BN3 / unit_m]
        vectors.append(state.rotation_BN33[..., 2])
        vectors += [state.omega_BN3] if self.angular_velocity else []
        # Row vectors times world_R_action: components along the action's axes.
        geometry_BNC = (torch.stack(vectors, -2) @ axes_B133).flatten(-2)
        height_BN1 = state.center_BN3[..., 2:] / unit_m
        node_BNC = torch.cat([features.node_BNC, geometry_BNC, height_BN1], -1)
        # NaN (no robot) becomes 0: the network then sees a tip that stays on the object.
        to_tip_BN3 = (tip.start_B3[:, None] - state.center_BN3).nan_to_num()
        to_tip_BN23 = torch.stack([to_tip_BN3, tip.action_B3[:, None].expand_as(to_tip_BN3)], -2)
        to_tip_BN6 = (to_tip_BN23 @ axes_B133).flatten(-2) / unit_m
        agent_BNC = self.agent_edge(torch.cat([node_BNC, to_tip_BN6, features.agent_BNC], -1))
        offset_BNN3 = state.center_BN3[:, None] - state.center_BN3[:, :, None]
        edge_BNNC = torch.cat([offset_BNN3 @ axes_B133 / unit_m, features.edge_BNNC], -1)
        is_edge_BNN1, pairs = valid_pairs(state.valid_BN)[..., None], (*edge_BNNC.shape[:-1], -1)
        hidden_BNC = node_BNC
        for edge, update in zip(self.edges, self.nodes, strict=True):
            ends = hidden_BNC[:, :, None].expand(pairs), hidden_BNC[:, None].expand(pairs)
            messages_BNNC = edge(torch.cat([*ends, edge_BNNC], -1)) * is_edge_BNN1
            # Every round sees the input of the node again, so that messages cannot displace it.
            hidden_BNC = update(torch.cat([node_BNC, agent_BNC, messages_BNNC.sum(2)], -1))
        out_BN23 = self.head(hidden_BNC).unflatten(-1, (2, 3)) @ axes_B133.mT
        return StepMotion(out_BN23[..., 0, :] * unit_m, out_BN23[..., 1, :])


def mlp(inputs: int, width: int, layers: int) -> nn.Sequential:
    """``layers`` linear layers with leaky ReLUs and Xavier initialisation (appendix C.1)."""
    sizes = pairwise([inputs] + [width] * layers)
    return nn.Sequential(*(x for fan in sizes for x in _activated(nn.Linear(*fan))))


def conv_encoder(inputs: int, channels: Sequence[int], kernel_px: int) -> nn.Sequential:
    """2D convolutions of stride 2 with leaky ReLUs and Xavier initialisation; output flattened."""
    # Lazily: each layer is initialised before the next one takes its random numbers.
    convs = (nn.Conv2d(*fan, kernel_px, 2, 1) for fan in pairwise((inputs, *channels)))
    return nn.Sequential(*(x for conv in convs for x in _activated(conv)), nn.Flatten())


def _activated(layer: nn.Linear | nn.Conv2d) -> tuple[nn.Module, nn.Module]:
    nn.init.xavier_uniform_(layer.weight)
    assert layer.bias is not None
    nn.init.zeros_(layer.bias)
    return layer, nn.LeakyReLU(0.01)


def yaw_rotation(angle_B: Tensor) -> Tensor:
    """Rotations B33 about the vertical by ``angle_B`` (radians)."""
    cos, sin = angle_B.cos(), angle_B.sin()
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    return torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], -1).reshape(-1, 3, 3)


def yaw(R: Tensor) -> Tensor:
    """Angle (radians) of the rotation about the vertical that is closest to rotations ...33."""
    return torch.atan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1])


def valid_pairs(valid_BN: Tensor) -> Tensor:
    """Mask BNN of the (receiver, sender) pairs of different valid objects."""
    others_NN = ~torch.eye(valid_BN.shape[1], dtype=torch.bool, device=valid_BN.device)
    return valid_BN[:, None] & valid_BN[:, :, None] & others_NN


def pair_indices(num: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Receivers E and senders E of all pairs of different objects."""
    receiver_E, sender_E = (~torch.eye(num, dtype=torch.bool, device=device)).nonzero().unbind(1)
    return receiver_E, sender_E


def scatter_pairs(edge_BEC: Tensor, num: int) -> Tensor:
    """Features BNNC of the pairs of ``pair_indices``; 0 from an object to itself."""
    edge_BNNC = edge_BEC.new_zeros(len(edge_BEC), num, num, edge_BEC.shape[-1])
    edge_BNNC[:, *pair_indices(num, edge_BEC.device)] = edge_BEC
    return edge_BNNC
