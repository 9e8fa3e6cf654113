"""The model beyond the paper: surfaces that touch (completed from images), and what that does to
them.

Where objects are pushed, rigid bodies slide (``oes.dynamics.rigid_body.sliding``): the outlines of
the completed surfaces, pushed by the rod and by each other. A graph network whose messages pass
between points of those surfaces corrects the motion of what slides; where objects fall, it
forecasts alone. Out of training, a forecast is the mean of several, of surfaces, masses and
frictions as they might be: their spread tells how sure it is.
"""

from typing import cast

import torch
from torch import Tensor

from oes.dynamics.encoders.surface_encoder import NOWHERE_M, SurfaceEncoder
from oes.dynamics.graph import GraphFeatures, ObjectState, StepMotion, action_axes, yaw
from oes.dynamics.models import GraphModel, InputSpec, NetConfig
from oes.dynamics.rigid_body.bodies import Pose, rotate_bodies
from oes.dynamics.rigid_body.sliding import slide
from oes.dynamics.shapes import ObjectShapes, shapes_of, unpacked
from oes.objects import Objects

PRIOR = 6  # numbers of the forecast that is corrected: displacement, turn, velocity
SEED = 0
STILL_M = 1e-6


class Contact(GraphModel):
    """Equivariant to shifts and to the order of objects by construction, to mirror images by
    augmentation. So it is to turns about the vertical (all is read in the action's axes), but for
    the rattle of sliding bodies, which makes more of the last bits: millimetres in a push of
    several centimetres.
    """

    READS_SURFACES = True

    def __init__(self, net: NetConfig, seen: InputSpec) -> None:
        cfg = net.contact
        super().__init__(net, seen, appearance=cfg.skin.width + PRIOR, contact=cfg.skin.width)
        self.sight = SurfaceEncoder(cfg.skin, net.graph.unit_m)

    @property
    def num_samples(self) -> int:
        """How many futures make up a forecast."""
        return 1 if self.training else self.net.contact.doubt.draws

    def look(self, objects: Objects) -> Tensor:
        """The surfaces, packed."""
        return shapes_of(objects).packed()

    def appearance(self, objects: Objects) -> Tensor:
        """``look``: mirror images are learned, not averaged over."""
        return self.look(objects)

    def sample(self, appearance_BNC: Tensor) -> Tensor:
        """The objects as they seem and as they might be instead, always in the same ways."""
        generator = torch.Generator().manual_seed(SEED)
        return self._shapes(appearance_BNC).sample(self.net.contact.doubt, generator).packed()

    def forward(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """Motion of every object over one action."""
        return self.step(appearance_BNC, state, tip_world_B3, action_B3)

    def step(
        self, appearance_BNC: Tensor, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """What sliding gives, corrected by the graph network; what does not slide stays, however
        many stand around.
        """
        shapes, unit_m = self._shapes(appearance_BNC), self.net.graph.unit_m
        prior, axes_B33 = self._slid(shapes, state, tip_world_B3, action_B3), action_axes(action_B3)
        assert prior.twist_BN3 is not None
        along_BN2, velocity_BN2 = (
            (x[..., :2] @ axes_B33[:, :2, :2]) for x in (prior.dp_BN3, prior.twist_BN3)
        )
        speeds = [
            velocity_BN2 * self.net.contact.step_s / unit_m,
            prior.twist_BN3[..., 2:] * self.net.contact.step_s,
        ]
        numbers_BNC = torch.cat([along_BN2 / unit_m, prior.spin_BN3[..., 2:], *speeds], -1)
        sight = self.sight(shapes, state, tip_world_B3, action_B3)
        sight = GraphFeatures(
            torch.cat([sight.own_BNC, numbers_BNC], -1), sight.path_BNC, sight.pair_BNNC
        )
        up_BN3 = state.turned_BN33[..., 2]
        found = cast(StepMotion, self.graph(sight, state, up_BN3, tip_world_B3, action_B3))
        if self.net.contact.physics is None:
            return StepMotion(found.dp_BN3, found.spin_BN3, prior.twist_BN3)
        slides_BN1 = prior.dp_BN3.norm(dim=-1, keepdim=True) > STILL_M
        dp_BN3, spin_BN3 = (x_BN3 * slides_BN1 for x_BN3 in (found.dp_BN3, found.spin_BN3))
        return StepMotion(prior.dp_BN3 + dp_BN3, prior.spin_BN3 + spin_BN3, prior.twist_BN3)

    @torch.no_grad()
    def _slid(
        self, shapes: ObjectShapes, state: ObjectState, tip_world_B3: Tensor, action_B3: Tensor
    ) -> StepMotion:
        """Sliding alone; where objects fall, no motion."""
        still_BN3 = torch.zeros_like(state.center_BN3)
        physics = self.net.contact.physics
        if physics is None:
            return StepMotion(still_BN3, still_BN3, still_BN3)
        bodies = shapes.bodies(state.valid_BN, self.net.contact.skin.band_m)
        turn_BN = yaw(state.turned_BN33)
        place_BN2 = state.center_BN3[..., :2] + rotate_bodies(bodies.mass_BN2, turn_BN)
        tip_B2 = tip_world_B3[:, :2].nan_to_num(nan=NOWHERE_M)
        pose = slide(
            bodies, Pose(place_BN2, turn_BN, state.twist_BN3), tip_B2, action_B3[:, :2], physics
        )
        now_BN2 = pose.place_BN2 - rotate_bodies(bodies.mass_BN2, pose.turn_BN)
        dp_BN3, spin_BN3 = still_BN3.clone(), still_BN3.clone()
        dp_BN3[..., :2] = now_BN2 - state.center_BN3[..., :2]
        spin_BN3[..., 2] = pose.turn_BN - turn_BN
        return StepMotion(dp_BN3, spin_BN3, pose.twist_BN3)

    def _shapes(self, appearance_BNC: Tensor) -> ObjectShapes:
        return unpacked(appearance_BNC, self.seen.profile_rows, self.seen.profile_directions)
