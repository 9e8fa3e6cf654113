"""Control tasks: which objects stand where, and where each shall go (paper appendix C.3)."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oes.config import params
from oes.episode import Body, Floats
from oes.meshes.catalogue import Catalogue, Mesh
from oes.mpc.sampler import PlannerConfig
from oes.sim.bodies import body_footprint, draw_body, true_box
from oes.sim.scene import ScatterConfig, SceneRejected, draw_meshes, scatter
from oes.sim.world import SimConfig
from oes.trials.obstacles import ObstaclesConfig, draw_obstacles


@params
class TrialScenario:
    """Objects to push to one goal each, and maybe obstacles that must not be touched.

    Goals lie ``goal_m`` (range) from their object's start, within +- ``goal_spread_m`` of the
    table's centre, and so far apart that the objects' boxes keep ``goal_gap_m`` however they are
    turned. A trial ends after ``max_steps`` pushes, when every object is believed within ``stop_m``
    of its goal, or when an obstacle is touched; it succeeds when the objects' true mean distance is
    under ``success_m``. ``settle_ms`` passes after each push. ``planners``: by name, the ways of
    searching that are tried on the same tasks.
    """

    num_objects: tuple[int, int]
    scatter: ScatterConfig
    goal_m: tuple[float, float]
    goal_spread_m: float
    goal_gap_m: float
    obstacles: ObstaclesConfig
    max_steps: int
    success_m: float
    stop_m: float
    settle_ms: int
    max_attempts: int
    planners: dict[str, PlannerConfig]


@dataclass(frozen=True)
class Task:
    """What stands where at the start, where the rod is, and where box centres shall go (world,
    metres).

    The first G objects have goals; the others are obstacles.
    """

    bodies: tuple[Body, ...]
    world_T_obj_N44: Floats
    center_N3: Floats
    goal_G3: Floats
    tip_xy_m: Floats


def generator(seed: int, scenario: str, trial_i: int, stream: int) -> np.random.Generator:
    """The random numbers of one purpose (stream) in one trial: the same for every model."""
    return np.random.default_rng([seed, zlib.crc32(scenario.encode()), trial_i, stream])


def draw_task(
    catalogue: Catalogue, sim: SimConfig, cfg: TrialScenario, rng: np.random.Generator
) -> Task:
    """Novel objects standing apart, some with a goal. Raises Rejected when no attempt fits the
    table.
    """
    reasons = []
    for _ in range(cfg.max_attempts):
        try:
            return _attempt(catalogue, sim, cfg, rng)
        except SceneRejected as error:
            reasons.append(str(error))
    raise SceneRejected(
        f"no task in {cfg.max_attempts} attempts; the last failed with: {reasons[-1]}"
    )


def _attempt(
    catalogue: Catalogue, sim: SimConfig, cfg: TrialScenario, rng: np.random.Generator
) -> Task:
    num_moved = int(rng.integers(cfg.num_objects[0], cfg.num_objects[1] + 1))
    meshes = draw_meshes(catalogue.split("test"), num_moved + cfg.obstacles.count, rng)
    bodies = tuple(draw_body(mesh, sim.bodies, rng) for mesh in meshes)
    things = list(zip(meshes, bodies, strict=True))
    poses = scatter(meshes[:num_moved], bodies[:num_moved], cfg.scatter, rng)
    center_G3, size_G3 = _boxes(things[:num_moved], poses)
    goal_G3 = _goals(center_G3, np.linalg.norm(size_G3[:, :2], axis=1) / 2, cfg, rng)
    if cfg.obstacles.count:
        way_22 = np.stack([center_G3[0, :2], goal_G3[0, :2]])
        outline = body_footprint(*things[0], poses[0])
        obstacles = draw_obstacles(
            outline, way_22, things[num_moved:], cfg.scatter, cfg.obstacles, rng
        )
        poses = np.concatenate([poses, obstacles])
    center_N3, size_N3 = _boxes(things, poses)
    return Task(bodies, poses, center_N3, goal_G3, _free_tip(center_N3, size_N3, sim, rng))


def _boxes(things: Sequence[tuple[Mesh, Body]], poses: Floats) -> tuple[Floats, Floats]:
    """Centres N3 and sizes N3 of the boxes of posed bodies."""
    boxes = [true_box(mesh, body, pose) for (mesh, body), pose in zip(things, poses, strict=True)]
    centers, sizes = (np.array(values) for values in zip(*boxes, strict=True))
    return centers, sizes


def _goals(
    center_N3: Floats, radius_N: Floats, cfg: TrialScenario, rng: np.random.Generator
) -> Floats:
    """A goal for each object at a uniform distance and bearing. Raises Rejected when they leave the
    table or crowd.
    """
    distance = rng.uniform(*cfg.goal_m, size=len(center_N3))
    bearing = rng.uniform(-np.pi, np.pi, size=len(center_N3))
    goals = center_N3 + distance[:, None] * np.stack(
        [np.cos(bearing), np.sin(bearing), 0 * bearing], axis=1
    )
    if np.abs(goals[:, :2]).max() > cfg.goal_spread_m:
        raise SceneRejected("a goal lies outside its bounds")
    for i, j in zip(*np.triu_indices(len(goals), 1), strict=True):
        if np.linalg.norm(goals[i] - goals[j]) < radius_N[i] + radius_N[j] + cfg.goal_gap_m:
            raise SceneRejected("two goals are too close to each other")
    return np.asarray(goals)


def _free_tip(
    center_N3: Floats, size_N3: Floats, sim: SimConfig, rng: np.random.Generator
) -> Floats:
    """A place for the rod off every object's box by its diameter. Raises Rejected after one
    miss.
    """
    tip_xy = rng.uniform(-sim.robot.workspace_m, sim.robot.workspace_m, size=2)
    outside = np.abs(tip_xy - center_N3[:, :2]) > size_N3[:, :2] / 2 + 2 * sim.robot.rod_radius_m
    if not outside.any(axis=1).all():
        raise SceneRejected("the rod would stand on an object")
    return np.asarray(tip_xy)
