"""Simulated world of closed-loop trials: one push at a time, with new cameras after each."""

from collections.abc import Sequence
from typing import Self

import numpy as np
import shapely

from oes.episode import Body, Floats, Step
from oes.meshes.catalogue import Catalogue
from oes.sim.arm import ReachError, joints_for
from oes.sim.bodies import body_footprint
from oes.sim.rig import rig
from oes.sim.world import NS_PER_MS, SimConfig, World


class PushWorld:
    """Objects on the table and the arm; a context manager. The arm stays where a push ended."""

    def __init__(self, catalogue: Catalogue, cfg: SimConfig, settle_ms: int) -> None:
        """``settle_ms``: time from the end of a push to the recorded state.

        Raises ValueError if a duration is no whole number of physics steps.
        """
        self._world, self._catalogue = World(catalogue, cfg), catalogue
        self._cfg, self._settle_ms = cfg, settle_ms
        self._t_ns = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._world.__exit__(*error)

    def reset(self, bodies: Sequence[Body], world_T_obj_N44: Floats, tip_xy_m: Floats) -> None:
        """Start a trial: settled bodies, and the rod down at ``tip_xy_m``. Raises ReachError."""
        self._world.reset(bodies, world_T_obj_N44, self._tip(tip_xy_m))
        self._world.run(self._settle_ms)
        self._world.clear_contacts()
        self._t_ns = 0

    def is_free(self, tip_xy_m: Floats) -> bool:
        """Whether the rod can be lowered: the tip is in reach and on none of the objects."""
        try:
            joints_for(self._tip(tip_xy_m)[None], self._cfg.robot)
        except ReachError:
            return False
        footprints = [
            body_footprint(self._catalogue.meshes[body.mesh], body, pose)
            for body, pose in zip(self._world.bodies, self._world.poses(), strict=True)
        ]
        tip, radius_m = shapely.Point(tip_xy_m), self._cfg.robot.rod_radius_m
        return all(footprint.distance(tip) > radius_m for footprint in footprints)

    def push(self, tip_start_xy_m: Floats, action_3: Floats, rng: np.random.Generator) -> Step:
        """Set the rod down at ``tip_start_xy_m``, push by ``action_3`` for one timestep, settle.

        The raised rod reaches the start by a joint reset, in no time and without contact. If the
        start is occupied (see ``is_free``), the rod stays and only time passes. The Step has the
        contacts of this push and its settling. Raises ReachError, before anything moves, if the
        start or the end is out of reach.
        """
        start, end = self._tip(tip_start_xy_m), self._tip(tip_start_xy_m) + action_3
        joints_for(np.stack([start, end]), self._cfg.robot)
        self._world.clear_contacts()
        if self.is_free(tip_start_xy_m):
            self._world.arm.reset_to(start)
            self._world.push(action_3)
        else:
            self._world.run(self._cfg.physics.timestep_ms)
        self._world.run(self._settle_ms)
        self._t_ns += (self._cfg.physics.timestep_ms + self._settle_ms) * NS_PER_MS
        return self.step_now(rng)

    def step_now(self, rng: np.random.Generator) -> Step:
        """The current state, with the cameras of a newly perturbed rig."""
        return self._world.step(self._t_ns, rig(self._cfg.rig, rng))

    def _tip(self, xy_m: Floats) -> Floats:
        return np.array([xy_m[0], xy_m[1], self._cfg.robot.tip_height_m])
