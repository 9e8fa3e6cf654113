"""What came of many trials: one row each, and films of some."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from oes.trials.loop import COLLIDED, TrialResult
from oes.trials.task import Task, TrialScenario
from oes.trials.trial_video import VideoConfig, write_trial_video

TRIAL_COLUMNS = (
    "scenario",
    "model",
    "planner",
    "plans",
    "horizon",
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


Videos = dict[tuple[str, int], str]  # (planner, trial) -> file name


@dataclass(frozen=True)
class Trial:
    """One finished trial. ``failure`` says why it broke off, or why there is no ``outcome``, or not
    even a ``task``.
    """

    planner: str
    trial_i: int
    task: Task | None
    outcome: TrialResult | None
    failure: str


def write_videos(
    trials: Sequence[Trial], scenario: TrialScenario, film: VideoConfig, num_videos: int, out: Path
) -> Videos:
    """Films of the first ``num_videos`` successes and failures of each planner."""
    names: Videos = {}
    for planner, is_success in product(scenario.planners, (True, False)):
        word = "success" if is_success else "failure"
        ran = [t for t in trials if t.planner == planner and t.outcome and t.outcome.moments]
        for trial in [t for t in ran if _succeeds(t, scenario) == is_success][:num_videos]:
            assert trial.task is not None and trial.outcome is not None
            name = names[planner, trial.trial_i] = f"{planner}_{trial.trial_i:03d}_{word}.mp4"
            verdict = trial.failure or f"{word}: {trial.outcome.final_G.mean() * 1e3:.0f} mm"
            write_trial_video(
                trial.outcome, trial.task.goal_G3, verdict, scenario.success_m, film, out / name
            )
    return names


def trial_rows(
    trials: Sequence[Trial], name: str, model: str, scenario: TrialScenario, videos: Videos
) -> list[dict[str, object]]:
    """One row a trial, of ``TRIAL_COLUMNS``; a trial that never began has no distances."""
    return [
        {
            "scenario": name,
            "model": model,
            "planner": trial.planner,
            "plans": (search := scenario.planners[trial.planner]).iterations
            * search.num_candidates,
            "horizon": search.horizon_steps,
            "trial_i": trial.trial_i,
            "num_objects": len(trial.task.bodies) if trial.task else 0,
            "success": _succeeds(trial, scenario),
            "all_success": _succeeds(trial, scenario) and _largest_m(trial) < scenario.success_m,
            "touched": trial.failure == COLLIDED,
            **_distances(trial.outcome),
            "steps_used": trial.outcome.steps_used if trial.outcome else 0,
            "failure": "" if trial.failure == COLLIDED else trial.failure,
            "video": videos.get((trial.planner, trial.trial_i), ""),
        }
        for trial in trials
    ]


def _succeeds(trial: Trial, scenario: TrialScenario) -> bool:
    """Mean true distance under the tolerance, in a trial that nothing broke off."""
    return (
        trial.outcome is not None
        and not trial.failure
        and bool(trial.outcome.final_G.mean() < scenario.success_m)
    )


def _largest_m(trial: Trial) -> float:
    return float(trial.outcome.final_G.max()) if trial.outcome else float("inf")


def _distances(outcome: TrialResult | None) -> dict[str, str]:
    names = ("initial_mm", "mean_final_mm", "believed_mm")
    if outcome is None:
        return dict.fromkeys(names, "nan")
    values = (outcome.initial_G, outcome.final_G, outcome.believed_G)
    return {name: f"{value.mean() * 1e3:.3f}" for name, value in zip(names, values, strict=True)}
