"""The dataset card of a split: statistics (card.json), a summary (card.md) and plots (card.png).

Every number is computed from the recorded states alone.
"""

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from oes.episode import Episode, Floats
from oes.episodes.capture import Failure
from oes.episodes.motion import displacement_mm, has_object_contact, impact_T, object_rotation_deg
from oes.sim.simulate import EpisodesConfig, count_rejected

HORIZONS = (1, 3, 5)
MOVED_MM = 10.0
CARD_INK, CARD_COLOURS = "#22262b", ("#0072b2", "#e69f00", "#009e73")


@dataclass(frozen=True)
class Spread:
    """Mean and quartiles."""

    mean: float
    q25: float
    median: float
    q75: float


@dataclass(frozen=True)
class DatasetCard:
    """Statistics of a split, the schema of card.json. Keys of the dictionaries by T: str(T).

    ``objects`` and ``meshes`` count episodes by number of objects, and uses of each mesh.
    ``most_moved_mm``, and ``share_moved`` (the share above ``MOVED_MM``), are of the object of each
    episode that moved farthest. ``rod_rms_mm`` is there with a robot, ``impact`` without: the share
    of episodes whose falling object has touched anything by T. ``displacements_mm`` lists the
    displacement of every object.
    """

    task: str
    split: str
    episodes: int
    left_out: list[Failure]
    rejected_attempts: int
    objects: dict[str, int]
    meshes: dict[str, int]
    displacement_mm: dict[str, Spread]
    most_moved_mm: dict[str, Spread]
    rotation_deg: dict[str, Spread]
    share_moved: dict[str, float]
    share_object_contact: float
    rod_rms_mm: dict[str, float] | None
    impact: dict[str, float] | None
    displacements_mm: dict[str, list[float]]


def statistics(
    episodes: Sequence[Episode], failures: Sequence[Failure], cfg: EpisodesConfig
) -> DatasetCard:
    """The card of a split. Raises ValueError if there is no episode."""
    if not episodes:
        raise ValueError("a split without a single episode; the reasons are in the log")
    first = episodes[0]
    horizons = [T for T in HORIZONS if T < len(first.steps)]
    moved_mm = {str(T): [displacement_mm(episode, T) for episode in episodes] for T in horizons}
    turned_deg = {
        str(T): [object_rotation_deg(episode, T) for episode in episodes] for T in horizons
    }
    all_mm = {T: np.concatenate(values) for T, values in moved_mm.items()}
    most_mm = {T: np.array([value.max() for value in values]) for T, values in moved_mm.items()}
    return DatasetCard(
        task=first.task,
        split=first.split,
        episodes=len(episodes),
        left_out=list(failures),
        rejected_attempts=sum(count_rejected(episode, cfg) for episode in episodes),
        objects=_count(len(episode.bodies) for episode in episodes),
        meshes=_count(body.mesh for episode in episodes for body in episode.bodies),
        displacement_mm={T: _spread(values) for T, values in all_mm.items()},
        most_moved_mm={T: _spread(values) for T, values in most_mm.items()},
        rotation_deg={T: _spread(np.concatenate(values)) for T, values in turned_deg.items()},
        share_moved={T: float((values > MOVED_MM).mean()) for T, values in most_mm.items()},
        share_object_contact=float(np.mean([has_object_contact(each) for each in episodes])),
        rod_rms_mm=_rod_rms_mm(episodes) if first.has_robot else None,
        impact=None if first.has_robot else _impact_share(episodes),
        displacements_mm={T: np.round(values, 2).tolist() for T, values in all_mm.items()},
    )


def write_card(card: DatasetCard, folder: Path) -> None:
    """Write card.json, card.md and card.png; equal cards give equal bytes."""
    tree = {name: value for name, value in asdict(card).items() if value is not None}
    (folder / "card.json").write_text(json.dumps(tree, indent=1) + "\n", encoding="utf-8")
    (folder / "card.md").write_text(_markdown(card), encoding="utf-8")
    _figure(card).savefig(folder / "card.png", dpi=110, metadata={"Software": None})


def _rod_rms_mm(episodes: Sequence[Episode]) -> dict[str, float]:
    rms_mm = np.array([episode.rod_rms_m for episode in episodes]) * 1000
    return {"mean": float(np.sqrt((rms_mm**2).mean())), "max": float(rms_mm.max())}


def _impact_share(episodes: Sequence[Episode]) -> dict[str, float]:
    first = [impact_T(episode) for episode in episodes]
    steps = range(1, len(episodes[0].steps))
    return {str(T): float(np.mean([t is not None and t <= T for t in first])) for T in steps}


def _count(values: Iterable[object]) -> dict[str, int]:
    return {str(value): count for value, count in sorted(Counter(values).items())}


def _spread(values: Floats) -> Spread:
    return Spread(float(values.mean()), *np.percentile(values, [25, 50, 75]).tolist())


def _markdown(card: DatasetCard) -> str:
    objects = ", ".join(f"{count} with {number}" for number, count in card.objects.items())
    rows = [
        f"| {T} | {all_mm.mean:.1f} | {all_mm.median:.1f} | {card.most_moved_mm[T].mean:.1f} "
        f"| {100 * card.share_moved[T]:.0f}% | {card.rotation_deg[T].mean:.1f} |"
        for T, all_mm in card.displacement_mm.items()
    ]
    left_out = [f"- episode {each.index}: {each.reason}" for each in card.left_out]
    lines = [
        f"# {card.task}, {card.split}\n",
        f"{card.episodes} episodes ({objects} objects); {card.rejected_attempts} rejected.",
        f"Two objects touch in {100 * card.share_object_contact:.0f}% of the episodes.",
        f"{_motion_cause(card)}\n",
        "Displacement and rotation of the objects after T actions:\n",
        "| T | mean mm | median mm | most moved object, mean mm | episodes with over 1 cm "
        "| mean rotation, deg |",
        "|---|---|---|---|---|---|",
        *rows,
        "\n![Displacements, and use of the meshes](card.png)\n",
        "Episodes left out:",
        *(left_out or ["- none"]),
    ]
    return "\n".join(lines) + "\n"


def _motion_cause(card: DatasetCard) -> str:
    if card.impact is not None:
        shares = ", ".join(f"{100 * share:.0f}% by T = {T}" for T, share in card.impact.items())
        return f"The falling object has touched something in {shares}."
    rod_mm = card.rod_rms_mm or {}
    return (
        f"RMS distance of the rod from its commanded path: {rod_mm['mean']:.3f} mm "
        f"(worst episode {rod_mm['max']:.3f} mm)."
    )


def _figure(card: DatasetCard) -> Figure:
    """Histogram of the displacements at each T, and how often each mesh is used."""
    with mpl.rc_context({"font.family": "DejaVu Sans", "font.size": 8, "text.color": CARD_INK}):
        figure = Figure(figsize=(10, 4.2), layout="constrained")
        left, right = figure.subplots(1, 2)
        edges = np.linspace(0, max(map(max, card.displacements_mm.values())) + 1, 41)
        for (T, values), colour in zip(card.displacements_mm.items(), CARD_COLOURS, strict=False):
            left.hist(values, edges, histtype="step", linewidth=1.6, color=colour, label=f"T = {T}")
        left.set(xlabel="displacement of an object, mm", ylabel="objects", yscale="symlog")
        left.legend(frameon=False)
        right.barh(range(len(card.meshes)), list(card.meshes.values()), color=CARD_COLOURS[0])
        right.set_yticks(range(len(card.meshes)), list(card.meshes), parse_math=False)
        right.set(xlabel="times used")
        right.tick_params(axis="y", labelsize=6)
        right.invert_yaxis()
        for panel in (left, right):
            panel.spines[["top", "right"]].set_visible(False)
    return figure
