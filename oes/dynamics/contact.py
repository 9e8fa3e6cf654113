"""The model ``contact``, which is not in the paper: surfaces in contact, completed from images.

Pushed objects slide as rigid bodies (``oes.dynamics.rigid_body``), whose shapes are the completed
surfaces; a graph network on surface points corrects the motion of those that slide. Falling
objects have no such prior: the graph network forecasts alone. In eval mode a forecast is the mean
over sampled shapes, masses and frictions, and their spread measures its uncertainty.
"""

from dataclasses import replace

import torch
import torch.nn.functional as F
from torch import Tensor

from oes.dynamics.encoders.surface_encoder import SurfaceEncoder
from oes.dynamics.graph import GraphFeatures, ObjectState, StepMotion, TipMotion, yaw
from oes.dynamics.models import GraphModel, InputSpec, NetConfig
from oes.dynamics.rigid_body.bodies import PlanarState, rotate_2d
from oes.dynamics.rigid_body.push import simulate_push
from oes.dynamics.shapes import ObjectShapes, shapes_of, unpack_shapes
from oes.objects import Objects

PRIOR_NUMBERS = 6  # displacement (2), yaw, velocity (2) and yaw rate after sliding
SEED = 0
MIN_SLIDE_M = 1e-6


class Contact(GraphModel):
    """Equivariant by construction to shifts and to the order of objects.

    Equivariance to mirroring is learned by augmentation. Rotations about the vertical are exact but
    for rounding errors, which the chaotic contacts of sliding bodies amplify to millimetres in a
    push of several centimetres.
    """

    USES_SURFACES = True
    AVERAGES_MIRROR = False

    def __init__(self, net: NetConfig, inputs: InputSpec) -> None:
        cfg = net.contact.surface_points
        super().__init__(net, inputs, cfg.width + PRIOR_NUMBERS, cfg.width)
        self.encoder = SurfaceEncoder(cfg, net.graph.unit_m)

    @property
    def num_samples(self) -> int:
        """Samples per forecast; training uses the perceived shapes alone."""
        return 1 if self.training else self.net.contact.uncertainty.num_samples

    def encode(self, objects: Objects) -> Tensor:
        """The surfaces, packed."""
        return shapes_of(objects).pack()

    def sample(self, appearance_BNC: Tensor) -> Tensor:
        """Packed surfaces of all samples; the same deviations in every call."""
        # Common random numbers: all plans and steps are compared on the same samples.
        generator = torch.Generator().manual_seed(SEED)
        uncertainty = self.net.contact.uncertainty
        return self._unpack(appearance_BNC).sample(uncertainty, generator).pack()

    def step(self, appearance_BNC: Tensor, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Sliding motion plus the graph network's correction; 0 for objects that do not slide."""
        contact, unit_m = self.net.contact, self.net.graph.unit_m
        shapes, axes_B22 = self._unpack(appearance_BNC), tip.axes_B33()[:, :2, :2]
        prior = self._slide(shapes, state, tip)
        assert prior.twist_BN3 is not None
        features: GraphFeatures = self.encoder(shapes, state, tip)
        node = [
            features.node_BNC,
            prior.dp_BN3[..., :2] @ axes_B22 / unit_m,
            prior.rotvec_BN3[..., 2:],
            prior.twist_BN3[..., :2] @ axes_B22 * contact.step_s / unit_m,
            prior.twist_BN3[..., 2:] * contact.step_s,
        ]
        features = replace(features, node_BNC=torch.cat(node, -1))
        residual: StepMotion = self.graph(features, state, tip)
        if contact.physics is None:
            return replace(residual, twist_BN3=prior.twist_BN3)
        # Without the mask, a bystander would drift by the network's residual error.
        slides_BN1 = prior.dp_BN3.norm(dim=-1, keepdim=True) > MIN_SLIDE_M
        return StepMotion(
            prior.dp_BN3 + residual.dp_BN3 * slides_BN1,
            prior.rotvec_BN3 + residual.rotvec_BN3 * slides_BN1,
            prior.twist_BN3,
        )

    @torch.no_grad()
    def _slide(self, shapes: ObjectShapes, state: ObjectState, tip: TipMotion) -> StepMotion:
        """Motion by rigid-body sliding alone; none where objects fall."""
        contact = self.net.contact
        if contact.physics is None:
            return StepMotion(*[torch.zeros_like(state.center_BN3)] * 3)
        bodies = shapes.bodies(state.valid_BN, contact.surface_points.layer_height_m)
        yaw_BN = yaw(state.rotation_BN33)
        com_BN2 = state.center_BN3[..., :2] + rotate_2d(bodies.com_offset_BN2, yaw_BN)
        after = simulate_push(
            bodies,
            PlanarState(com_BN2, yaw_BN, state.twist_BN3),
            tip.finite_start_B3()[:, :2],
            tip.action_B3[:, :2],
            contact.physics,
        )
        center_BN2 = after.com_BN2 - rotate_2d(bodies.com_offset_BN2, after.yaw_BN)
        dp_BN3 = F.pad(center_BN2 - state.center_BN3[..., :2], (0, 1))
        rotvec_BN3 = F.pad((after.yaw_BN - yaw_BN)[..., None], (2, 0))
        return StepMotion(dp_BN3, rotvec_BN3, after.twist_BN3)

    def _unpack(self, appearance_BNC: Tensor) -> ObjectShapes:
        inputs = self.inputs
        return unpack_shapes(appearance_BNC, inputs.profile_rows, inputs.profile_directions)
