"""All trials of a scenario with one model.

Tasks, cameras and plan samples are seeded by the trial, so they are the same for every model.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import joblib
import numpy as np
import torch

from oes.baselines.overhead_camera import OverheadView
from oes.baselines.overhead_render import OverheadRenderer
from oes.config import Shared, params
from oes.episode import Body, Camera, Step
from oes.meshes.catalogue import Catalogue, load_catalogue
from oes.mpc.scene import Rod
from oes.perception.perceiver import Perceiver
from oes.progress import resumable_map
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses, scene_meshes
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.pushing import PushWorld
from oes.sim.robot import robot_shape
from oes.sim.scene import SceneRejected
from oes.sim.world import SimConfig
from oes.trials.loop import run_trial
from oes.trials.planner import CameraObservation, Planner, PlanningConfig
from oes.trials.results import Trial
from oes.trials.task import TrialScenario, draw_task, generator
from oes.trials.trial_video import VideoConfig
from oes.trials.world_models import WorldModel, load_world_model

TASK_STREAM, CAMERA_STREAM, PLAN_STREAM = range(3)  # of random numbers

# Worker processes keep the catalogue and the network from trial to trial.
_catalogue = lru_cache(maxsize=1)(load_catalogue)
_perceiver = lru_cache(maxsize=1)(Perceiver.load)


class ScenarioError(ValueError):
    """A scenario name that params.yaml does not define."""


@params
class TrialsConfig:
    """The section ``trials``; ``num_trials`` and ``num_videos`` are per planner."""

    seed: int
    num_trials: int
    num_workers: int
    num_videos: int
    scenarios: dict[str, TrialScenario]
    planning: PlanningConfig
    video: VideoConfig
    sim: Shared[SimConfig]


@dataclass(frozen=True)
class TrialInputs:
    """Folder of the catalogue, file of perception's weights, folder of the world model."""

    meshes: Path
    perception: Path
    dynamics: Path


def run_trials(
    cfg: TrialsConfig, scenario: str, inputs: TrialInputs, progress: Path
) -> list[Trial]:
    """Run ``num_trials`` trials with each planner of a scenario, in parallel processes.

    Finished trials are kept in the folder ``progress`` and reused. Raises ScenarioError.
    """
    if scenario not in cfg.scenarios:
        valid = ", ".join(cfg.scenarios)
        raise ScenarioError(f"unknown scenario '{scenario}'; trials.scenarios has: {valid}")
    progress.mkdir(exist_ok=True)
    trials = product(cfg.scenarios[scenario].planners, range(cfg.num_trials))
    paths = {progress / f"{planner}-{i:06d}.joblib": (planner, i) for planner, i in trials}

    def make(trial: tuple[str, int], path: Path) -> None:
        joblib.dump(run_one(cfg, scenario, inputs, *trial), path)

    desc = f"trials {scenario}"
    resumable_map(make, paths, num_workers=cfg.num_workers, desc=desc, unit="trial")
    return [joblib.load(path) for path in paths]


def run_one(cfg: TrialsConfig, name: str, inputs: TrialInputs, planner: str, trial_i: int) -> Trial:
    """Run one trial in this process, on one core; expected errors become its failure."""
    torch.set_num_threads(1)
    scenario = cfg.scenarios[name]
    catalogue = _catalogue(inputs.meshes)
    task_rng, camera_rng, plan_rng = (
        generator(cfg.seed, name, trial_i, stream)
        for stream in (TASK_STREAM, CAMERA_STREAM, PLAN_STREAM)
    )
    try:
        task = draw_task(catalogue, cfg.sim, scenario, task_rng)
    except SceneRejected as error:
        return Trial(planner, trial_i, None, None, str(error))
    agent = make_planner(cfg, _perceiver(inputs.perception), load_world_model(inputs.dynamics))
    sensor = CameraSensor(catalogue, cfg.sim, task.bodies, agent.world_model.view)
    planner_cfg, rngs = scenario.planners[planner], (camera_rng, plan_rng)
    try:
        with PushWorld(catalogue, cfg.sim, scenario.settle_ms) as env:
            result = run_trial(env, sensor, agent, task, scenario, planner_cfg, rngs)
    except (ReachError, BulletError) as error:
        return Trial(planner, trial_i, task, None, str(error))
    return Trial(planner, trial_i, task, result, result.failure)


def make_planner(cfg: TrialsConfig, perceiver: Perceiver, world_model: WorldModel) -> Planner:
    """A planner for the simulated robot and table."""
    robot = cfg.sim.robot
    rod = Rod(robot.rod_radius_m, robot.tip_height_m, robot.workspace_m)
    half_m = min(cfg.sim.physics.table_size_m[:2]) / 2
    voxel_m = perceiver.net.cfg.roi.voxel_m
    return Planner(perceiver, voxel_m, world_model, rod, half_m, cfg.planning)


class CameraSensor:
    """Renders states: RGB-D and segmentation of one camera, and an overhead image if ``view``."""

    def __init__(
        self,
        catalogue: Catalogue,
        sim: SimConfig,
        bodies: Sequence[Body],
        view: OverheadView | None = None,
    ) -> None:
        table_m = sim.physics.table_size_m
        meshes = scene_meshes(np.array(table_m), robot_shape(sim.robot), bodies, catalogue)
        self._renderer = Renderer(meshes)
        self._overhead = view and OverheadRenderer(catalogue, table_m, bodies, view)

    def __call__(self, state: Step, camera: Camera) -> CameraObservation:
        frames = self._renderer.render(mesh_poses(state), [camera])
        return CameraObservation(frames, camera, self._overhead(state) if self._overhead else None)
