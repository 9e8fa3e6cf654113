"""Many trials of one model: the same starts, goals, cameras and proposals for every model, one row a trial."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from joblib import Parallel, delayed
from tqdm import tqdm

from oes.config import params
from oes.control.proposals import Push, Rod
from oes.dynamics.checkpoint import load_model
from oes.episode import Body, Camera, Frames, Step
from oes.meshes.catalogue import Catalogue, load_catalogue
from oes.percept.perceiver import Perceiver
from oes.render.renderer import Renderer
from oes.render.scene import mesh_poses, scene_meshes
from oes.sim.arm import ReachError
from oes.sim.client import BulletError
from oes.sim.pushing import PushWorld
from oes.sim.robot import robot_shape
from oes.sim.scene import Rejected
from oes.sim.world import Sim
from oes.trial.loop import Outcome, Planner, Track, run_trial
from oes.trial.pictures import Film, write_trial
from oes.trial.task import Targets, Task, draw_task, generator

TASKS, CAMERAS, PLANS = range(3)  # streams of random numbers
ROWS = (
    "scenario",
    "model",
    "trial_i",
    "num_objects",
    "success",
    "all_success",
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
    scenarios: dict[str, Targets]
    push: Push
    track: Track
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

    trial_i: int
    task: Task | None
    outcome: Outcome | None
    failure: str


def run_trials(cfg: Trials, scenario: str, inputs: Inputs) -> list[Trial]:
    """All trials of a scenario, in order, on ``cfg.num_workers`` processes. Raises ScenarioError."""
    if scenario not in cfg.scenarios:
        raise ScenarioError(f"unknown scenario '{scenario}'; trials.scenarios has: {', '.join(cfg.scenarios)}")
    jobs = (delayed(run_one)(cfg, scenario, inputs, trial_i) for trial_i in range(cfg.count))
    done = Parallel(n_jobs=cfg.num_workers, return_as="generator_unordered")(jobs)
    found = list(tqdm(done, total=cfg.count, desc=f"trials {scenario}", unit="trial", mininterval=1))
    return sorted(found, key=lambda trial: trial.trial_i)


def run_one(cfg: Trials, scenario: str, inputs: Inputs, trial_i: int) -> Trial:
    """One trial in this process, on one core; what goes wrong in it is its failure."""
    torch.set_num_threads(1)
    targets = cfg.scenarios[scenario]
    catalogue = _catalogue(inputs.meshes)
    try:
        task = draw_task(catalogue, cfg.sim, targets, generator(cfg.seed, scenario, trial_i, TASKS))
    except Rejected as error:
        return Trial(trial_i, None, None, str(error))
    robot = cfg.sim.robot
    rod = Rod(robot.rod_radius_m, robot.tip_height_m, robot.workspace_m)
    eyes = _perceiver(inputs.perception)
    voxel_m = eyes.net.cfg.roi.voxel_m
    planner = Planner(eyes, voxel_m, load_model(inputs.dynamics), rod, cfg.push, cfg.track)
    rngs = tuple(generator(cfg.seed, scenario, trial_i, stream) for stream in (CAMERAS, PLANS))
    photographer = Photographer(catalogue, cfg.sim, task.bodies)
    try:
        with PushWorld(catalogue, cfg.sim, targets.settle_ms) as world:
            outcome = run_trial(world, photographer, planner, task, targets, (rngs[0], rngs[1]))
    except (ReachError, BulletError) as error:
        return Trial(trial_i, task, None, str(error))
    return Trial(trial_i, task, outcome, outcome.failure)


class Photographer:
    """Takes pictures of a world's states: RGB, depth and segmentation from one camera."""

    def __init__(self, catalogue: Catalogue, sim: Sim, bodies: Sequence[Body]) -> None:
        table_m = np.array(sim.physics.table_size_m)
        self._renderer = Renderer(scene_meshes(table_m, robot_shape(sim.robot), bodies, catalogue))

    def __call__(self, step: Step, camera: Camera) -> Frames:
        """The state as ``camera`` sees it (V = 1)."""
        return self._renderer.render(mesh_poses(step), [camera])


def write_videos(trials: Sequence[Trial], targets: Targets, cfg: Trials, out: Path) -> dict[int, str]:
    """Films of the first ``num_videos`` successes and failures; trial -> file name."""
    names: dict[int, str] = {}
    for is_success, word in ((True, "success"), (False, "failure")):
        chosen = [t for t in trials if t.outcome and t.outcome.moments and _succeeds(t, targets) == is_success]
        for trial in chosen[: cfg.num_videos]:
            assert trial.task is not None and trial.outcome is not None
            name = names[trial.trial_i] = f"trial_{trial.trial_i:03d}_{word}.mp4"
            verdict = f"{word}: {trial.outcome.final_N.mean() * 1e3:.0f} mm"
            write_trial(trial.outcome, trial.task.goal_N3, verdict, targets.success_m, cfg.film, out / name)
    return names


def trial_rows(
    trials: Sequence[Trial], scenario: str, model: str, targets: Targets, videos: dict[int, str]
) -> list[dict[str, object]]:
    """One row a trial, of ``ROWS``; a trial that never began has no distances."""
    return [
        {
            "scenario": scenario,
            "model": model,
            "trial_i": trial.trial_i,
            "num_objects": len(trial.task.bodies) if trial.task else 0,
            "success": _succeeds(trial, targets),
            "all_success": _succeeds(trial, targets) and _largest_m(trial) < targets.success_m,
            **_distances(trial.outcome),
            "steps_used": trial.outcome.steps_used if trial.outcome else 0,
            "failure": trial.failure,
            "video": videos.get(trial.trial_i, ""),
        }
        for trial in trials
    ]


def _succeeds(trial: Trial, targets: Targets) -> bool:
    """Mean true distance under the tolerance, in a trial that nothing broke off."""
    return trial.outcome is not None and not trial.failure and bool(trial.outcome.final_N.mean() < targets.success_m)


def _largest_m(trial: Trial) -> float:
    return float(trial.outcome.final_N.max()) if trial.outcome else float("inf")


def _distances(outcome: Outcome | None) -> dict[str, str]:
    names = ("initial_mm", "mean_final_mm", "believed_mm")
    if outcome is None:
        return dict.fromkeys(names, "nan")
    values = (outcome.initial_N, outcome.final_N, outcome.believed_N)
    return {name: f"{value.mean() * 1e3:.3f}" for name, value in zip(names, values, strict=True)}


@lru_cache(maxsize=1)
def _catalogue(folder: Path) -> Catalogue:
    return load_catalogue(folder)


@lru_cache(maxsize=1)
def _perceiver(path: Path) -> Perceiver:
    return Perceiver.load(path)
