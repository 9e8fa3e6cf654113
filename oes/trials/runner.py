"""Many trials of one model: the same starts, goals, cameras and proposals for every model, one row
a trial.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from joblib import Memory, Parallel, delayed
from tqdm import tqdm

from oes.baselines.overhead_camera import OverheadView
from oes.baselines.overhead_render import OverheadRenderer
from oes.config import Shared, params
from oes.episode import Body, Camera, Step
from oes.meshes.catalogue import Catalogue, load_catalogue
from oes.mpc.sampler import Rod
from oes.perception.network import SceneFeatures as View
from oes.perception.perceiver import Perceiver
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses, scene_meshes
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.pushing import PushWorld
from oes.sim.robot import robot_shape
from oes.sim.scene import SceneRejected
from oes.sim.world import SimConfig
from oes.trials.loop import run_trial
from oes.trials.planner import Observation, Planner, PlanningConfig
from oes.trials.results import Trial
from oes.trials.task import TrialScenario, draw_task, generator
from oes.trials.trial_video import VideoConfig
from oes.trials.world_models import WorldModel, load_world_model

TASKS, CAMERAS, PLANS = range(3)  # streams of random numbers


class ScenarioError(ValueError):
    """A scenario that params.yaml does not have."""


@params
class TrialsConfig:
    """The section ``trials``. ``num_videos``: of successes and of failures each."""

    seed: int
    count: int
    num_workers: int
    num_videos: int
    scenarios: dict[str, TrialScenario]
    planning: PlanningConfig
    film: VideoConfig
    sim: Shared[SimConfig]


@dataclass(frozen=True)
class TrialInputs:
    """Where everything that a worker loads lies: the catalogue's folder, perception's weights, the
    model's folder.
    """

    meshes: Path
    perception: Path
    dynamics: Path


def run_trials(
    cfg: TrialsConfig, scenario: str, inputs: TrialInputs, progress: Path
) -> list[Trial]:
    """All trials of a scenario with each of its planners, in order, on ``cfg.num_workers``
    processes.

    Finished trials are kept in the folder ``progress`` and reused. Raises ScenarioError.
    """
    if scenario not in cfg.scenarios:
        raise ScenarioError(
            f"unknown scenario '{scenario}'; trials.scenarios has: {', '.join(cfg.scenarios)}"
        )
    planners = list(cfg.scenarios[scenario].planners)
    todo = [(planner, trial_i) for planner in planners for trial_i in range(cfg.count)]
    one = delayed(Memory(progress, verbose=0).cache(run_one))
    jobs = (one(cfg, scenario, inputs, *which) for which in todo)
    done = Parallel(n_jobs=cfg.num_workers, return_as="generator_unordered")(jobs)
    found = list(
        tqdm(done, total=len(todo), desc=f"trials {scenario}", unit="trial", mininterval=1)
    )
    return sorted(found, key=lambda trial: (planners.index(trial.planner), trial.trial_i))


def run_one(cfg: TrialsConfig, name: str, inputs: TrialInputs, planner: str, trial_i: int) -> Trial:
    """One trial in this process, on one core; what goes wrong in it is its failure."""
    torch.set_num_threads(1)
    scenario = cfg.scenarios[name]
    catalogue = _catalogue(inputs.meshes)
    try:
        task = draw_task(catalogue, cfg.sim, scenario, generator(cfg.seed, name, trial_i, TASKS))
    except SceneRejected as error:
        return Trial(planner, trial_i, None, None, str(error))
    agent = make_planner(cfg, _perceiver(inputs.perception), load_world_model(inputs.dynamics))
    rngs = tuple(generator(cfg.seed, name, trial_i, stream) for stream in (CAMERAS, PLANS))
    photographer = CameraSensor(catalogue, cfg.sim, task.bodies, agent.mind.view)
    try:
        with PushWorld(catalogue, cfg.sim, scenario.settle_ms) as world:
            search = scenario.planners[planner]
            outcome = run_trial(
                world, photographer, agent, task, scenario, search, (rngs[0], rngs[1])
            )
    except (ReachError, BulletError) as error:
        return Trial(planner, trial_i, task, None, str(error))
    return Trial(planner, trial_i, task, outcome, outcome.failure)


def make_planner(cfg: TrialsConfig, eyes: Perceiver, mind: WorldModel) -> Planner[View]:
    """The planner that sees with ``eyes`` and imagines with ``mind``."""
    robot = cfg.sim.robot
    rod = Rod(robot.rod_radius_m, robot.tip_height_m, robot.workspace_m)
    half_m = min(cfg.sim.physics.table_size_m[:2]) / 2
    return Planner(eyes, eyes.net.cfg.roi.voxel_m, mind, rod, half_m, cfg.planning)


class CameraSensor:
    """Takes pictures of a world's states: RGB, depth and segmentation from one camera, and RGB from
    above if wanted.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        sim: SimConfig,
        bodies: Sequence[Body],
        view: OverheadView | None = None,
    ) -> None:
        table_m = np.array(sim.physics.table_size_m)
        self._renderer = Renderer(scene_meshes(table_m, robot_shape(sim.robot), bodies, catalogue))
        self._overhead = view and OverheadRenderer(catalogue, sim.physics.table_size_m, bodies, view)

    def __call__(self, step: Step, camera: Camera) -> Observation:
        """The state as ``camera`` sees it."""
        frames = self._renderer.render(mesh_poses(step), [camera])
        return Observation(frames, camera, self._overhead(step) if self._overhead else None)


@lru_cache(maxsize=1)
def _catalogue(folder: Path) -> Catalogue:
    return load_catalogue(folder)


@lru_cache(maxsize=1)
def _perceiver(path: Path) -> Perceiver:
    return Perceiver.load(path)
