"""The object graph network that every learned dynamics model shares (paper section 3.2, appendix
C.1).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from oes.config import params


@params
class GraphConfig:
    """Width and depth of each MLP, rounds of message passing, the length that counts as 1 inside
    the network, and whether an object's last rotation is an input (as its last displacement always
    is): what falls keeps spinning.
    """

    width: int
    layers: int
    rounds: int
    unit_m: float
    spin: bool


@dataclass(frozen=True)
class ObjectState:
    """Where N objects are after some steps; frames are world, lengths metres.

    ``center_BN3`` is the reference point (the box centre at t = 0, carried along), ``velocity_BN3``
    its last displacement and ``spin_BN3`` the last rotation (as a vector, radians); ``moved_BN3``
    is its displacement since t = 0, ``turned_BN33`` the rotation since t = 0. ``twist_BN3`` is the
    velocity on the table at this moment (m/s, m/s, rad/s) of models that follow it, else 0.
    """

    center_BN3: Tensor
    velocity_BN3: Tensor
    spin_BN3: Tensor
    moved_BN3: Tensor
    turned_BN33: Tensor
    twist_BN3: Tensor
    valid_BN: Tensor


def mirrored(state: ObjectState, mirror_33: Tensor) -> ObjectState:
    """The state of the mirrored world; ``mirror_33`` is its own inverse."""
    return ObjectState(
        center_BN3=state.center_BN3 @ mirror_33,
        velocity_BN3=state.velocity_BN3 @ mirror_33,
        spin_BN3=-state.spin_BN3 @ mirror_33,
        moved_BN3=state.moved_BN3 @ mirror_33,
        turned_BN33=mirror_33 @ state.turned_BN33 @ mirror_33,
        twist_BN3=state.twist_BN3 * state.twist_BN3.new_tensor([1.0, -1.0, -1.0]),
        valid_BN=state.valid_BN,
    )


@dataclass(frozen=True)
class GraphFeatures:
    """What a model sees at one step, in the action's axes; widths may be 0.

    ``own_BNC``: each object as a whole; ``path_BNC``: where the tip passes it; ``pair_BNNC``:
    between receiver and sender.
    """

    own_BNC: Tensor
    path_BNC: Tensor
    pair_BNNC: Tensor


def node_features_only(appearance_BNC: Tensor) -> GraphFeatures:
    """A sight of whole objects alone."""
    empty_BN0 = appearance_BNC[..., :0]
    return GraphFeatures(
        appearance_BNC, empty_BN0, empty_BN0[:, :, None].expand(-1, -1, appearance_BNC.shape[1], -1)
    )


@dataclass(frozen=True)
class StepMotion:
    """One step of every object: displacement of its reference point (metres) and rotation vector,
    in world axes; its velocity afterwards, of models that follow it (see ``ObjectState``).
    """

    dp_BN3: Tensor
    spin_BN3: Tensor
    twist_BN3: Tensor | None = None


def mlp(inputs: int, width: int, layers: int) -> nn.Sequential:
    """``layers`` linear layers of ``width``, each followed by a leaky ReLU; Xavier initialisation
    (appendix C.1).
    """
    modules: list[nn.Module] = []
    for fan_in, fan_out in pairwise([inputs] + [width] * layers):
        linear = nn.Linear(fan_in, fan_out)
        nn.init.xavier_uniform_(linear.weight)
        nn.init.zeros_(linear.bias)
        modules += [linear, nn.LeakyReLU(0.01)]
    return nn.Sequential(*modules)


class GraphNet(nn.Module):
    """Nodes are the objects and the end effector; edges run to every object from every other node.

    Every vector is given in axes turned about the vertical so that the action points along x, and
    the outputs are turned back: a scene and the same scene turned are one and the same to the
    network.
    """

    NODE_GEOMETRY = 10  # velocity, displacement since t = 0, height above the table, tilt
    AGENT_GEOMETRY = 6  # the tip's position from the object, the action
    EDGE_GEOMETRY = 3  # the sender's position from the receiver

    def __init__(self, cfg: GraphConfig, appearance: int, contact: int = 0) -> None:
        """Widths of ``GraphFeatures.own_BNC``, and of its other two."""
        super().__init__()
        self.unit_m, self.spin = cfg.unit_m, cfg.spin
        node, edge = appearance + self.NODE_GEOMETRY + 3 * cfg.spin, contact + self.EDGE_GEOMETRY
        self.from_agent = mlp(node + contact + self.AGENT_GEOMETRY, cfg.width, cfg.layers)
        senders = [node] + [cfg.width] * (cfg.rounds - 1)
        self.edges = nn.ModuleList(mlp(2 * size + edge, cfg.width, cfg.layers) for size in senders)
        self.nodes = nn.ModuleList(
            mlp(node + 2 * cfg.width, cfg.width, cfg.layers) for _ in senders
        )
        self.head = nn.Linear(cfg.width, 6)
        nn.init.xavier_uniform_(self.head.weight, gain=0.1)
        nn.init.zeros_(self.head.bias)

    def forward(
        self,
        sight: GraphFeatures,
        state: ObjectState,
        up_BN3: Tensor,
        tip_world_B3: Tensor,
        action_B3: Tensor,
    ) -> StepMotion:
        """Motion of each object while the tip goes from ``tip_world_B3`` by ``action_B3`` (metres).

        ``up_BN3`` is where each object's own vertical points. A tip of NaN says that there is no
        robot.
        """
        axes_B33 = action_axes(action_B3)
        node_BNC = self._node(sight.own_BNC, state, up_BN3, axes_B33)
        to_tip_BN3 = (tip_world_B3[:, None] - state.center_BN3).nan_to_num()
        reach_BN23 = torch.stack([to_tip_BN3, action_B3[:, None].expand_as(to_tip_BN3)], -2)
        reach_BN6 = (reach_BN23 @ axes_B33[:, None]).flatten(-2) / self.unit_m
        pushed_BNC = self.from_agent(torch.cat([node_BNC, reach_BN6, sight.path_BNC], -1))
        apart_BNN3 = (
            (state.center_BN3[:, None] - state.center_BN3[:, :, None])
            @ axes_B33[:, None]
            / self.unit_m
        )
        edge_BNNC = torch.cat([apart_BNN3, sight.pair_BNNC], -1)
        others_BNN1 = valid_pairs(state.valid_BN)[..., None]
        hidden_BNC = node_BNC
        for edge, update in zip(self.edges, self.nodes, strict=True):
            messages_BNNC = edge(_receiver_sender(hidden_BNC, edge_BNNC)) * others_BNN1
            hidden_BNC = update(torch.cat([node_BNC, pushed_BNC, messages_BNNC.sum(2)], -1))
        out_BN23 = (
            self.head(hidden_BNC).reshape(*hidden_BNC.shape[:-1], 2, 3) @ axes_B33.mT[:, None]
        )
        return StepMotion(out_BN23[..., 0, :] * self.unit_m, out_BN23[..., 1, :])

    def _node(
        self, appearance_BNC: Tensor, state: ObjectState, up_BN3: Tensor, axes_B33: Tensor
    ) -> Tensor:
        """What an object knows of itself: appearance, velocity, displacement, tilt, spin,
        height.
        """
        vectors = [state.velocity_BN3 / self.unit_m, state.moved_BN3 / self.unit_m, up_BN3]
        own_BNK3 = torch.stack([*vectors, state.spin_BN3] if self.spin else vectors, -2)
        height_BN1 = state.center_BN3[..., 2:] / self.unit_m
        return torch.cat(
            [appearance_BNC, (own_BNK3 @ axes_B33[:, None]).flatten(-2), height_BN1], -1
        )


def action_axes(action_B3: Tensor) -> Tensor:
    """``world_R_action`` B33: x along the horizontal action (the world's x where there is none), z
    up.
    """
    angle_B = torch.atan2(action_B3[:, 1], action_B3[:, 0])
    cos, sin, zero, one = (
        angle_B.cos(),
        angle_B.sin(),
        torch.zeros_like(angle_B),
        torch.ones_like(angle_B),
    )
    return torch.stack([cos, -sin, zero, sin, cos, zero, zero, zero, one], -1).reshape(-1, 3, 3)


def yaw(R: Tensor) -> Tensor:
    """The angle (radians) of the turn about the vertical that comes nearest to rotations ...33."""
    return torch.atan2(R[..., 1, 0] - R[..., 0, 1], R[..., 0, 0] + R[..., 1, 1])


def conv_encoder(inputs: int, channels: Sequence[int], kernel_px: int) -> nn.Sequential:
    """2D convolutions, each halving the image, with a leaky ReLU after each; then flattened. Xavier
    initialisation.
    """
    modules: list[nn.Module] = []
    for fan_in, fan_out in pairwise((inputs, *channels)):
        conv = nn.Conv2d(fan_in, fan_out, kernel_px, stride=2, padding=1)
        nn.init.xavier_uniform_(conv.weight)
        nn.init.zeros_(conv.bias)  # type: ignore[arg-type]
        modules += [conv, nn.LeakyReLU(0.01)]
    return nn.Sequential(*modules, nn.Flatten())


def valid_pairs(valid_BN: Tensor) -> Tensor:
    """Which (receiver, sender) pairs exist, BNN: of valid objects, none with itself."""
    return (
        valid_BN[:, None]
        & valid_BN[:, :, None]
        & distinct_pairs(valid_BN.shape[1], valid_BN.device)
    )


def distinct_pairs(num: int, device: torch.device) -> Tensor:
    """Pairs NN of different objects."""
    return ~torch.eye(num, dtype=torch.bool, device=device)


def _receiver_sender(hidden_BNC: Tensor, geometry_BNNC: Tensor) -> Tensor:
    """Inputs of the edge network: receiver's and sender's hidden state and the geometry of the
    pair.
    """
    pairs = (*geometry_BNNC.shape[:-1], hidden_BNC.shape[-1])
    return torch.cat(
        [hidden_BNC[:, :, None].expand(pairs), hidden_BNC[:, None].expand(pairs), geometry_BNNC], -1
    )
