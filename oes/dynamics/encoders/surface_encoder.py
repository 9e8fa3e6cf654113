"""Encoder of completed surfaces: points of each surface near the rod and near other objects.

A small network reads every point; the feature of a node or an edge pools over its points.
"""

import torch
from torch import Tensor, nn

from oes.config import params
from oes.dynamics import graph
from oes.dynamics.graph import NOWHERE_M, GraphFeatures, ObjectState, TipMotion
from oes.dynamics.rigid_body.bodies import ContactPhysics
from oes.dynamics.shapes import ObjectShapes, ShapeUncertainty
from oes.geom.polar import profile_normals, profile_points, radius_at
from oes.objects import LAYERS

NODE_CHANNELS = 9  # offset, normal, sigma and presence of a point, and its height above the table
AGENT_CHANNELS = 4  # offset (2) and distance from the rod's path, distance along it
EDGE_CHANNELS = 6  # offset from the sender, depth inside it, height above its support, existence
GAP_CHANNELS = 2  # clearance above and below the sender
FAR_M = 0.1


@params
class SurfacePoints:
    """Surface points of an encoder, and the width and depth of the networks that read them.

    Points lie in every ``direction_stride``-th direction of ``rows`` of the radial profile (see
    ``oes.objects``; layers are ``layer_height_m`` high).
    """

    direction_stride: int
    rows: tuple[int, ...]
    layer_height_m: float
    width: int
    mlp_layers: int

    @property
    def has_heights(self) -> bool:
        """Whether all points lie in layers and therefore have definite heights."""
        return min(self.rows) >= LAYERS


@params
class ContactConfig:
    """The model ``contact``. ``physics`` of sliding is null where objects fall.

    ``step_s``: duration of a step; ``gt_surfaces``: ground-truth surfaces as input (an ablation).
    """

    surface_points: SurfacePoints
    physics: ContactPhysics | None
    uncertainty: ShapeUncertainty
    step_s: float
    gt_surfaces: bool


class PointNet(nn.Module):
    """Points ...PC to one feature ...C: a shared MLP, then mean and maximum over the points."""

    def __init__(self, inputs: int, cfg: SurfacePoints) -> None:
        super().__init__()
        self.point_mlp = graph.mlp(inputs, cfg.width, cfg.mlp_layers)
        self.head = graph.mlp(2 * cfg.width, cfg.width, 1)

    def forward(self, points_PC: Tensor, presence_P: Tensor) -> Tensor:
        """Points are weighted by their existence probability ``presence_P``."""
        point_PC = self.point_mlp(points_PC) * presence_P[..., None]
        mean_C = point_PC.sum(-2) / presence_P.sum(-1, keepdim=True).clamp(min=1)
        feature_C: Tensor = self.head(torch.cat([mean_C, point_PC.amax(-2)], -1))
        return feature_C


class SurfaceEncoder(nn.Module):
    """Graph features of one step from surface points. No gradient flows through their positions."""

    def __init__(self, cfg: SurfacePoints, unit_m: float) -> None:
        super().__init__()
        self.cfg, self.unit_m = cfg, unit_m
        self.node = PointNet(NODE_CHANNELS, cfg)
        self.agent = PointNet(NODE_CHANNELS + AGENT_CHANNELS, cfg)
        gaps = GAP_CHANNELS * cfg.has_heights
        self.edge = PointNet(NODE_CHANNELS + EDGE_CHANNELS + gaps, cfg)

    def forward(self, shapes: ObjectShapes, state: ObjectState, tip: TipMotion) -> GraphFeatures:
        """Features in the action's axes."""
        axes_B33, num = tip.axes_B33(), shapes.radius_BNRD.shape[1]
        i_E, j_E = graph.pair_indices(num, axes_B33.device)
        with torch.no_grad():
            offset_BNP3, normal_BNP3, sigma_BNP, presence_BNP = self.points(shapes, state, axes_B33)
            points_BNP3 = offset_BNP3 + state.center_BN3[:, :, None] @ axes_B33[:, None]
            node = [offset_BNP3 / self.unit_m, normal_BNP3, sigma_BNP[..., None]]
            node += [presence_BNP[..., None], points_BNP3[..., 2:] / self.unit_m]
            node_BNPC = torch.cat(node, -1)
            agent_BNPC = torch.cat([node_BNPC, self._agent_inputs(points_BNP3, tip, axes_B33)], -1)
            edge_BNNPC = self.edge_inputs(shapes, state, points_BNP3, axes_B33)
            edge_BEPC = torch.cat([node_BNPC[:, i_E], edge_BNNPC[:, i_E, j_E]], -1)
        return GraphFeatures(
            node_BNC=self.node(node_BNPC, presence_BNP),
            agent_BNC=self.agent(agent_BNPC, presence_BNP),
            edge_BNNC=graph.scatter_pairs(self.edge(edge_BEPC, presence_BNP[:, i_E]), num),
        )

    def points(self, shapes: ObjectShapes, state: ObjectState, axes: Tensor) -> tuple[Tensor, ...]:
        """Points and normals BNP3 from the reference points, scaled sigmas BNP, presences BNP."""
        rows, stride = list(self.cfg.rows), self.cfg.direction_stride
        radius_BNRD = shapes.radius_BNRD[:, :, rows]
        xy_BNRD2 = profile_points(radius_BNRD)
        # UNION and UPPER span all heights; their points get that of the lowest layer's middle.
        layer_R = torch.tensor([max(row - LAYERS, 0) + 0.5 for row in rows])
        z_BNR = (layer_R * self.cfg.layer_height_m) + self._bottom(shapes)[..., None]
        z_BNRD1 = z_BNR[..., None].expand(radius_BNRD.shape)[..., None]
        to_action_BN33 = state.rotation_BN33.mT @ axes[:, None]
        offset = torch.cat([xy_BNRD2, z_BNRD1], -1)
        normal = torch.cat([profile_normals(radius_BNRD), torch.zeros_like(z_BNRD1)], -1)
        vectors = (x[..., ::stride, :].flatten(2, 3) @ to_action_BN33 for x in (offset, normal))
        sigma = shapes.sigma_BNRD / self.unit_m
        presence = shapes.presence_BNRD * (shapes.radius_BNRD > 0)
        scalars = (x[:, :, rows, ::stride].flatten(2) for x in (sigma, presence))
        return *vectors, *scalars

    def _bottom(self, shapes: ObjectShapes) -> Tensor:
        """Height BN of the lowest layer's bottom, from the reference point.

        Without definite heights, the stack of existing layers is centred at the reference point.
        """
        if self.cfg.has_heights:
            return -shapes.support_depth_BN
        exists_BNR = (shapes.radius_BNRD[:, :, LAYERS:] > 0).any(-1).float()
        return -exists_BNR.sum(-1) * self.cfg.layer_height_m / 2

    def _agent_inputs(self, points_BNP3: Tensor, tip: TipMotion, axes_B33: Tensor) -> Tensor:
        """BNP4: offset (x, y) and distance from the rod's path, and the distance along the path."""
        start_B13 = tip.finite_start_B3()[:, None] @ axes_B33
        length_B11 = tip.action_B3[:, :2].norm(dim=-1)[:, None, None]
        x_BNP, y_BNP = (points_BNP3[..., :2] - start_B13[:, None, :, :2]).unbind(-1)
        along_BNP = x_BNP.clamp(min=0).minimum(length_B11)
        offset_BNP2 = torch.stack([x_BNP - along_BNP, y_BNP], -1)
        distance_BNP1 = offset_BNP2.norm(dim=-1, keepdim=True).clamp(max=FAR_M)
        inputs = [offset_BNP2.clamp(-FAR_M, FAR_M), distance_BNP1, along_BNP[..., None]]
        return torch.cat(inputs, -1) / self.unit_m

    def edge_inputs(
        self, shapes: ObjectShapes, state: ObjectState, points_BNP3: Tensor, axes_B33: Tensor
    ) -> Tensor:
        """BNNPC: position of each receiver's points relative to each sender (action's axes).

        Offset from its reference point (3), depth inside its surface at that height, height above
        its support, ``_gaps`` where points have heights, and whether it exists at that height.
        """
        num, layer_height_m = points_BNP3.shape[1], self.cfg.layer_height_m
        center_BN3 = state.center_BN3 @ axes_B33
        offset_BNNP3 = points_BNP3[:, :, None] - center_BN3[:, None, :, None]
        # The sender's own axes at t = 0, in which its profile is given.
        first_BNNP3 = offset_BNNP3 @ axes_B33.mT[:, None, None] @ state.rotation_BN33[:, None]
        height_BNNP = first_BNNP3[..., 2] - self._bottom(shapes)[:, None, :, None]
        layers_BNRD = shapes.radius_BNRD[:, :, LAYERS:]
        layers_ERD = layers_BNRD[:, None].expand(-1, num, -1, -1, -1).flatten(0, 2)
        points_EP2, top = first_BNNP3[..., :2].flatten(0, 2), layers_BNRD.shape[2] - 1
        layer_BNNP = (height_BNNP / layer_height_m).floor().long()
        radius_EP = radius_at(layers_ERD, layer_BNNP.clamp(0, top).flatten(0, 2), points_EP2)
        radius_BNNP = radius_EP.reshape(height_BNNP.shape)
        depth_BNNP = radius_BNNP - first_BNNP3[..., :2].norm(dim=-1)
        exists_BNNP = (layer_BNNP >= 0) & (layer_BNNP <= top) & (radius_BNNP > 0)
        lengths = [offset_BNNP3, depth_BNNP[..., None], height_BNNP[..., None]]
        if self.cfg.has_heights:
            lengths.append(self._gaps(shapes.height_BN, layers_ERD, points_EP2, height_BNNP))
        near = torch.cat(lengths, -1).clamp(-2 * FAR_M, 2 * FAR_M) / self.unit_m
        return torch.cat([near, exists_BNNP.float()[..., None]], -1)

    def _gaps(self, height: Tensor, layers_ERD: Tensor, points_EP2: Tensor, z: Tensor) -> Tensor:
        """BNNP2: clearance of each point's layer above the sender's top and below its bottom.

        Measured along the point's vertical; negative when they overlap, ``NOWHERE_M`` where the
        sender has no surface. An object's highest layer ends at the top of its box.
        """
        layer_m, count, points = self.cfg.layer_height_m, layers_ERD.shape[1], z.shape[-1]
        row_EQ = torch.arange(count).repeat_interleave(points).expand(len(layers_ERD), -1)
        radius_EQ = radius_at(layers_ERD, row_EQ, points_EP2.repeat(1, count, 1))
        is_over_EQ = radius_EQ > points_EP2.norm(dim=-1).repeat(1, count)
        is_over_BNNRP = is_over_EQ.reshape(*z.shape[:3], count, points)
        bottom_R1 = torch.arange(count)[:, None] * layer_m
        top_BNR1 = (bottom_R1 + layer_m).minimum(height[..., None, None])
        sender_top_BNNP = torch.where(is_over_BNNRP, top_BNR1[:, None], -NOWHERE_M).amax(-2)
        sender_bottom_BNNP = torch.where(is_over_BNNRP, bottom_R1, NOWHERE_M).amin(-2)
        layer_R = torch.tensor(self.cfg.rows) - LAYERS
        layer_P = layer_R.repeat_interleave(points // len(layer_R))
        own_top_BNP = ((layer_P + 1) * layer_m).minimum(height[..., None])
        above_BNP = own_top_BNP - (layer_P + 0.5) * layer_m
        below_BNNP = sender_bottom_BNNP - (z + above_BNP[:, :, None])
        return torch.stack([z - layer_m / 2 - sender_top_BNNP, below_BNNP], -1)
