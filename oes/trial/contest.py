"""Many trials of one model: the same starts, goals, cameras and proposals for every model, one row a trial."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
import torch
from joblib import Parallel, delayed
from tqdm import tqdm

from oes.config import params
from oes.control.proposals import Rod
from oes.dynamics.checkpoint import load_model
from oes.dynamics.unroll import Model
from oes.episode import Body, Camera, Frames, Step
from oes.meshes.catalogue import Catalogue, load_catalogue
from oes.percept.network import Scene as View
from oes.percept.perceiver import Perceiver
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses, scene_meshes
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.pushing import PushWorld
from oes.sim.robot import robot_shape
from oes.sim.scene import Rejected
from oes.sim.world import Sim
from oes.trial.loop import TOUCHED, Outcome, Planner, Planning, run_trial
from oes.trial.pictures import Film, write_trial
from oes.trial.task import Scenario, Task, draw_task, generator

TASKS, CAMERAS, PLANS = range(3)  # streams of random numbers
ROWS = (
    "scenario",
    "model",
    "planner",
    "trial_i",
    "num_objects",
    "success",
    "all_success",
    "touched",
    "initial_mm",
    "mean_final_mm",
    "believed_mm",
    "steps_used",
    "failure",
    "video",
)


class ScenarioError(ValueError):
    """A scenario that params.yaml does not have."""


@params
class Trials:
    """The section ``trials``. ``num_videos``: of successes and of failures each."""

    seed: int
    count: int
    num_workers: int
    num_videos: int
    scenarios: dict[str, Scenario]
    planning: Planning
    film: Film
    sim: Sim


@dataclass(frozen=True)
class Inputs:
    """Where everything that a worker loads lies: the catalogue's folder, perception's weights, the model's folder."""

    meshes: Path
    perception: Path
    dynamics: Path


@dataclass(frozen=True)
class Trial:
    """One finished trial. ``failure`` says why it broke off, or why there is no ``outcome``, or not even a ``task``."""

    planner: str
    trial_i: int
    task: Task | None
    outcome: Outcome | None
    failure: str


def run_trials(cfg: Trials, scenario: str, inputs: Inputs) -> list[Trial]:
    """All trials of a scenario with each of its planners, in order, on ``cfg.num_workers`` processes.

    Raises ScenarioError.
    """
    if scenario not in cfg.scenarios:
        raise ScenarioError(f"unknown scenario '{scenario}'; trials.scenarios has: {', '.join(cfg.scenarios)}")
    planners = list(cfg.scenarios[scenario].planners)
    todo = [(planner, trial_i) for planner in planners for trial_i in range(cfg.count)]
    jobs = (delayed(run_one)(cfg, scenario, inputs, *which) for which in todo)
    done = Parallel(n_jobs=cfg.num_workers, return_as="generator_unordered")(jobs)
    found = list(tqdm(done, total=len(todo), desc=f"trials {scenario}", unit="trial", mininterval=1))
    return sorted(found, key=lambda trial: (planners.index(trial.planner), trial.trial_i))


def run_one(cfg: Trials, name: str, inputs: Inputs, planner: str, trial_i: int) -> Trial:
    """One trial in this process, on one core; what goes wrong in it is its failure."""
    torch.set_num_threads(1)
    scenario = cfg.scenarios[name]
    catalogue = _catalogue(inputs.meshes)
    try:
        task = draw_task(catalogue, cfg.sim, scenario, generator(cfg.seed, name, trial_i, TASKS))
    except Rejected as error:
        return Trial(planner, trial_i, None, None, str(error))
    agent = make_planner(cfg, _perceiver(inputs.perception), load_model(inputs.dynamics))
    rngs = tuple(generator(cfg.seed, name, trial_i, stream) for stream in (CAMERAS, PLANS))
    photographer = Photographer(catalogue, cfg.sim, task.bodies)
    try:
        with PushWorld(catalogue, cfg.sim, scenario.settle_ms) as world:
            search = scenario.planners[planner]
            outcome = run_trial(world, photographer, agent, task, scenario, search, (rngs[0], rngs[1]))
    except (ReachError, BulletError) as error:
        return Trial(planner, trial_i, task, None, str(error))
    return Trial(planner, trial_i, task, outcome, outcome.failure)


def make_planner(cfg: Trials, eyes: Perceiver, model: Model) -> Planner[View]:
    """The planner that sees with ``eyes`` and imagines with ``model``."""
    robot = cfg.sim.robot
    rod = Rod(robot.rod_radius_m, robot.tip_height_m, robot.workspace_m)
    half_m = min(cfg.sim.physics.table_size_m[:2]) / 2
    return Planner(eyes, eyes.net.cfg.roi.voxel_m, model, rod, half_m, cfg.planning)


class Photographer:
    """Takes pictures of a world's states: RGB, depth and segmentation from one camera."""

    def __init__(self, catalogue: Catalogue, sim: Sim, bodies: Sequence[Body]) -> None:
        table_m = np.array(sim.physics.table_size_m)
        self._renderer = Renderer(scene_meshes(table_m, robot_shape(sim.robot), bodies, catalogue))

    def __call__(self, step: Step, camera: Camera) -> Frames:
        """The state as ``camera`` sees it (V = 1)."""
        return self._renderer.render(mesh_poses(step), [camera])


def write_videos(trials: Sequence[Trial], scenario: Scenario, cfg: Trials, out: Path) -> dict[tuple[str, int], str]:
    """Films of the first ``num_videos`` successes and failures of each planner; (planner, trial) -> file name."""
    names: dict[tuple[str, int], str] = {}
    for planner, is_success in product(scenario.planners, (True, False)):
        word = "success" if is_success else "failure"
        ran = [t for t in trials if t.planner == planner and t.outcome and t.outcome.moments]
        for trial in [t for t in ran if _succeeds(t, scenario) == is_success][: cfg.num_videos]:
            assert trial.task is not None and trial.outcome is not None
            name = names[planner, trial.trial_i] = f"{planner}_{trial.trial_i:03d}_{word}.mp4"
            verdict = trial.failure or f"{word}: {trial.outcome.final_G.mean() * 1e3:.0f} mm"
            write_trial(trial.outcome, trial.task.goal_G3, verdict, scenario.success_m, cfg.film, out / name)
    return names


def trial_rows(
    trials: Sequence[Trial], name: str, model: str, scenario: Scenario, videos: dict[tuple[str, int], str]
) -> list[dict[str, object]]:
    """One row a trial, of ``ROWS``; a trial that never began has no distances."""
    return [
        {
            "scenario": name,
            "model": model,
            "planner": trial.planner,
            "trial_i": trial.trial_i,
            "num_objects": len(trial.task.bodies) if trial.task else 0,
            "success": _succeeds(trial, scenario),
            "all_success": _succeeds(trial, scenario) and _largest_m(trial) < scenario.success_m,
            "touched": trial.failure == TOUCHED,
            **_distances(trial.outcome),
            "steps_used": trial.outcome.steps_used if trial.outcome else 0,
            "failure": "" if trial.failure == TOUCHED else trial.failure,
            "video": videos.get((trial.planner, trial.trial_i), ""),
        }
        for trial in trials
    ]


def _succeeds(trial: Trial, scenario: Scenario) -> bool:
    """Mean true distance under the tolerance, in a trial that nothing broke off."""
    return trial.outcome is not None and not trial.failure and bool(trial.outcome.final_G.mean() < scenario.success_m)


def _largest_m(trial: Trial) -> float:
    return float(trial.outcome.final_G.max()) if trial.outcome else float("inf")


def _distances(outcome: Outcome | None) -> dict[str, str]:
    names = ("initial_mm", "mean_final_mm", "believed_mm")
    if outcome is None:
        return dict.fromkeys(names, "nan")
    values = (outcome.initial_G, outcome.final_G, outcome.believed_G)
    return {name: f"{value.mean() * 1e3:.3f}" for name, value in zip(names, values, strict=True)}


@lru_cache(maxsize=1)
def _catalogue(folder: Path) -> Catalogue:
    return load_catalogue(folder)


@lru_cache(maxsize=1)
def _perceiver(path: Path) -> Perceiver:
    return Perceiver.load(path)
