"""Rows and videos of finished trials."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from oes.trials.loop import COLLIDED, TrialResult
from oes.trials.task import Task, TrialScenario
from oes.trials.trial_video import VideoConfig, write_trial_video

Videos = dict[tuple[str, int], str]  # (planner, trial) -> file name


@dataclass(frozen=True)
class Trial:
    """A finished trial; ``failure``: reason of an early end, a missing task or a missing result."""

    planner: str
    trial_i: int
    task: Task | None
    result: TrialResult | None
    failure: str

    def distance_m(self) -> float:
        """Mean final distance of the objects to their goals; infinite without a result."""
        return float(self.result.final_G.mean()) if self.result else float("inf")

    def succeeds(self, success_m: float) -> bool:
        """Whether the trial ended regularly with a mean distance below ``success_m``."""
        return not self.failure and self.distance_m() < success_m


def write_videos(
    trials: Sequence[Trial], scenario: TrialScenario, cfg: VideoConfig, num_videos: int, out: Path
) -> Videos:
    """Videos of the first ``num_videos`` successes and failures of each planner."""
    names: Videos = {}
    for planner, is_success in product(scenario.planners, (True, False)):
        finished = [t for t in trials if t.planner == planner and t.result]
        label = "success" if is_success else "failure"
        chosen = [t for t in finished if t.succeeds(scenario.success_m) == is_success]
        for trial in chosen[:num_videos]:
            assert trial.task is not None and trial.result is not None
            name = names[planner, trial.trial_i] = f"{planner}_{trial.trial_i:03d}_{label}.mp4"
            verdict = trial.failure or f"{label}: {trial.distance_m() * 1e3:.0f} mm"
            goals, path = trial.task.goal_G3, out / name
            write_trial_video(trial.result, goals, verdict, scenario.success_m, cfg, path)
    return names


def trial_rows(
    trials: Sequence[Trial], name: str, model: str, scenario: TrialScenario, videos: Videos
) -> list[dict[str, object]]:
    """A row of ``oes.schema.TRIALS`` per trial; a trial that never began has no distances."""
    return [
        {
            "scenario": name,
            "model": model,
            "planner": trial.planner,
            "plans": (cfg := scenario.planners[trial.planner]).iterations * cfg.num_candidates,
            "horizon": cfg.horizon_steps,
            "trial_i": trial.trial_i,
            "num_objects": len(trial.task.bodies) if trial.task else 0,
            **_measures(trial, scenario.success_m),
            "failure": "" if trial.failure == COLLIDED else trial.failure,
            "video": videos.get((trial.planner, trial.trial_i), ""),
        }
        for trial in trials
    ]


def _measures(trial: Trial, success_m: float) -> dict[str, object]:
    result, is_success = trial.result, trial.succeeds(success_m)
    distances = (result.initial_G, result.final_G, result.estimated_G) if result else ()
    initial, final, estimated = [f"{d.mean() * 1e3:.3f}" for d in distances] or ["nan"] * 3
    return {
        "success": is_success,
        "all_success": bool(is_success and result and result.final_G.max() < success_m),
        "collided": trial.failure == COLLIDED,
        "initial_mm": initial,
        "mean_final_mm": final,
        "estimated_mm": estimated,
        "steps_used": result.steps_used if result else 0,
    }
