"""The card of a split: what its episodes hold, in numbers (card.json), words (card.md) and a
picture (card.png).

Displacements are of the objects' box centres since the start; every figure comes from the recorded
states alone.
"""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from oes.episode import SEG_FIRST_OBJECT, Episode, Floats
from oes.episodes.capture import Failure
from oes.sim.simulate import EpisodesConfig, count_rejected

HORIZONS = (1, 3, 5)
MOVED_MM = 10.0
OBJECTS_FROM = (
    SEG_FIRST_OBJECT - 1
)  # where objects begin in Step.contact_AA: after the table and the robot
INK, BARS = "#22262b", ("#0072b2", "#e69f00", "#009e73")


def statistics(
    episodes: Sequence[Episode], failures: Sequence[Failure], cfg: EpisodesConfig
) -> dict[str, Any]:
    """Numbers of a split that may be written as JSON. Raises ValueError where there is no episode
    at all.
    """
    if not episodes:
        raise ValueError("a split without a single episode; the reasons are in the log")
    horizons = [T for T in HORIZONS if T < len(episodes[0].steps)]
    moved_mm = {
        T: np.concatenate([displacement_mm(episode, T) for episode in episodes]) for T in horizons
    }
    pushed_mm = {
        T: np.array([displacement_mm(episode, T).max() for episode in episodes]) for T in horizons
    }
    return {
        "task": episodes[0].task,
        "split": episodes[0].split,
        "episodes": len(episodes),
        "left_out": [asdict(failure) for failure in failures],
        "rejected_attempts": sum(count_rejected(episode, cfg) for episode in episodes),
        "objects": _counted(len(episode.bodies) for episode in episodes),
        "meshes": _counted(body.mesh for episode in episodes for body in episode.bodies),
        "displacement_mm": {str(T): _spread(values) for T, values in moved_mm.items()},
        "most_moved_mm": {str(T): _spread(values) for T, values in pushed_mm.items()},
        "rotation_deg": {
            str(T): _spread(np.concatenate([rotation_deg(episode, T) for episode in episodes]))
            for T in horizons
        },
        "share_moved": {
            str(T): float((values > MOVED_MM).mean()) for T, values in pushed_mm.items()
        },
        "share_object_contact": float(
            np.mean([has_object_contact(episode) for episode in episodes])
        ),
        **(_rod(episodes) if episodes[0].has_robot else _impact(episodes)),
        "displacements_mm": {
            str(T): np.round(values, 2).tolist() for T, values in moved_mm.items()
        },
    }


def displacement_mm(episode: Episode, T: int) -> Floats:
    """How far each object's box centre at the start, carried with the object, has come after T
    actions: N.
    """
    first, step = episode.steps[0], episode.steps[T]
    motion = step.world_T_obj_N44 @ np.linalg.inv(first.world_T_obj_N44)
    carried = (motion[:, :3, :3] @ first.center_N3[..., None])[..., 0] + motion[:, :3, 3]
    return np.asarray(np.linalg.norm(carried - first.center_N3, axis=1) * 1000)


def rotation_deg(episode: Episode, T: int) -> Floats:
    """Angle N by which each object has turned after T actions."""
    R = episode.steps[T].world_T_obj_N44[:, :3, :3] @ episode.steps[0].world_T_obj_N44[
        :, :3, :3
    ].swapaxes(-1, -2)
    return np.asarray(
        np.degrees(np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    )


def impact_T(episode: Episode) -> int | None:
    """The first T by which the last object, which falls, has touched anything; None where it never
    does.
    """
    return next((T for T, step in enumerate(episode.steps) if step.contact_AA[-1].any()), None)


def has_object_contact(episode: Episode) -> bool:
    """Whether two objects touched at any moment."""
    return any(step.contact_AA[OBJECTS_FROM:, OBJECTS_FROM:].any() for step in episode.steps)


def write_card(card: Mapping[str, Any], folder: Path) -> None:
    """Write card.json, card.md and card.png, the same bytes for the same numbers."""
    (folder / "card.json").write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")
    (folder / "card.md").write_text(_words(card), encoding="utf-8")
    _picture(card).savefig(folder / "card.png", dpi=110, metadata={"Software": None})


def _rod(episodes: Sequence[Episode]) -> dict[str, Any]:
    """How well the rod keeps to its path."""
    rms_mm = np.array([episode.rod_rms_m for episode in episodes]) * 1000
    return {"rod_rms_mm": {"mean": float(np.sqrt((rms_mm**2).mean())), "max": float(rms_mm.max())}}


def _impact(episodes: Sequence[Episode]) -> dict[str, Any]:
    """The share of episodes whose falling object has touched something by each T."""
    at = [impact_T(episode) for episode in episodes]
    steps = range(1, len(episodes[0].steps))
    return {
        "impact": {
            str(T): float(np.mean([first is not None and first <= T for first in at]))
            for T in steps
        }
    }


def _counted(things: Any) -> dict[str, int]:
    return {str(thing): count for thing, count in sorted(Counter(things).items())}


def _spread(values: Floats) -> dict[str, float]:
    quartiles = np.percentile(values, [25, 50, 75])
    return {
        "mean": float(values.mean()),
        **dict(zip(("q25", "median", "q75"), quartiles.tolist(), strict=True)),
    }


def _words(card: Mapping[str, Any]) -> str:
    rows = [
        f"| {T} | {card['displacement_mm'][T]['mean']:.1f} | {card['displacement_mm'][T]['median']:.1f} "
        f"| {card['most_moved_mm'][T]['mean']:.1f} | {100 * card['share_moved'][T]:.0f}% "
        f"| {card['rotation_deg'][T]['mean']:.1f} |"
        for T in card["displacement_mm"]
    ]
    left_out = [f"- episode {each['index']}: {each['reason']}" for each in card["left_out"]] or [
        "- none"
    ]
    objects = ", ".join(f"{count} with {number}" for number, count in card["objects"].items())
    lines = [
        f"# {card['task']}, {card['split']}",
        "",
        f"{card['episodes']} episodes ({objects} objects); {card['rejected_attempts']} attempts rejected on the way.",
        f"Two objects touch in {100 * card['share_object_contact']:.0f}% of the episodes.",
        _moving(card),
        "",
        "| T | all objects: mean mm | median mm | most moved: mean mm | episodes with over 1 cm | mean turn, deg |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        "![displacements, turns and meshes](card.png)",
        "",
        "Left out:",
        *left_out,
        "",
    ]
    return "\n".join(lines)


def _moving(card: Mapping[str, Any]) -> str:
    """A sentence on what sets things in motion."""
    if "impact" in card:
        shares = ", ".join(f"{100 * share:.0f}% by T = {T}" for T, share in card["impact"].items())
        return f"The falling object has touched something in {shares}."
    rod = card["rod_rms_mm"]
    return f"The rod keeps to its commanded path within {rod['mean']:.3f} mm RMS (worst {rod['max']:.3f} mm)."


def _picture(card: Mapping[str, Any]) -> Figure:
    """Histogram of displacements at each T beside the number of times every mesh is used."""
    with mpl.rc_context({"font.family": "DejaVu Sans", "font.size": 8, "text.color": INK}):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        edges = np.linspace(
            0, max(max(values) for values in card["displacements_mm"].values()) + 1, 41
        )
        for (T, values), colour in zip(card["displacements_mm"].items(), BARS, strict=False):
            left.hist(values, edges, histtype="step", linewidth=1.6, color=colour, label=f"T = {T}")
        left.set(xlabel="displacement of an object, mm", ylabel="objects", yscale="symlog")
        left.legend(frameon=False)
        right.barh(list(card["meshes"]), list(card["meshes"].values()), color=BARS[0])
        right.set(xlabel="times used")
        right.tick_params(axis="y", labelsize=6)
        right.invert_yaxis()
        for panel in (left, right):
            panel.spines[["top", "right"]].set_visible(False)
    return figure
