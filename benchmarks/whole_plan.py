"""Time (ms) of one step of a trial with an obstacle: perception, and planning with each planner."""

import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch

from oes.apps.assets import DATASETS, KEPT, find_catalogue, find_weights
from oes.config import load
from oes.perception.perceiver import Perceiver
from oes.sim.pushing import PushWorld
from oes.trials.runner import (
    CAMERA_STREAM,
    PLAN_STREAM,
    TASK_STREAM,
    CameraSensor,
    TrialsConfig,
    make_planner,
)
from oes.trials.task import draw_task, generator
from oes.trials.world_models import load_world_model

SCENARIO, MODELS, REPEATS = "obstacle", ("contact", "oes", "graph_xyz"), 10


def median_ms(call: Callable[[], object]) -> float:
    """Median wall-clock time of ``REPEATS`` calls."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        call()
        times.append((time.perf_counter() - start) * 1e3)
    return statistics.median(times)


def main() -> None:
    """Print a line per model: median times of perception and of each planner of the scenario."""
    cfg = load(Path("params.yaml"), "trials", TrialsConfig)
    scenario, catalogue = cfg.scenarios[SCENARIO], find_catalogue()
    perception, dynamics = find_weights((DATASETS, KEPT), MODELS)
    perceiver = Perceiver.load(perception)
    task = draw_task(catalogue, cfg.sim, scenario, generator(cfg.seed, "bench", 0, TASK_STREAM))
    with PushWorld(catalogue, cfg.sim, scenario.settle_ms) as world:
        world.reset(task.bodies, task.world_T_obj_N44, task.tip_xy_m)
        step = world.step_now(generator(cfg.seed, "bench", 0, CAMERA_STREAM))
    observation = CameraSensor(catalogue, cfg.sim, task.bodies)(step, step.cameras[0])
    size_N3 = np.full_like(task.center_N3, cfg.planning.track.unseen_size_m)
    planners = [
        f"{name} {s.iterations}x{s.num_candidates}x{s.horizon_steps}"
        for name, s in scenario.planners.items()
    ]
    head = "".join(f"{name + ' ms':>24}" for name in planners)
    print(f"{'model':<12}{'perceive ms':>12}{head}   ({torch.get_num_threads()} threads)")
    for name in MODELS:
        planner = make_planner(cfg, perceiver, load_world_model(dynamics[name]))
        estimate = planner.perceive(observation, task.center_N3, size_N3)
        perceive_ms = median_ms(partial(planner.perceive, observation, task.center_N3, size_N3))
        rng = generator(cfg.seed, "bench", 0, PLAN_STREAM)
        plans = [
            median_ms(partial(planner.plan, estimate, task.goal_G3, s, rng))
            for s in scenario.planners.values()
        ]
        print(f"{name:<12}{perceive_ms:>12.0f}" + "".join(f"{ms:>24.0f}" for ms in plans))


if __name__ == "__main__":
    main()
