"""The charts of an episode as SVG: the table from above, displacement over time, contacts over
time.
"""

from html import escape
from itertools import combinations

import numpy as np

from oes.episode import Episode, Floats
from oes.record.pictures import object_color

MM = 1000.0
PLAN_PX, CHART_WIDTH_PX, CHART_HEIGHT_PX, ROW_PX, LABEL_PX = 300, 420, 150, 18, 150
TABLE_HALF_M = 0.3


def displacement_mm(episode: Episode) -> Floats:
    """How far the origin of each object is from where it began, at each state: array T+1, N."""
    origins_TN3 = np.array([step.world_T_obj_N44[:, :3, 3] for step in episode.steps])
    distance_mm: Floats = np.linalg.norm(origins_TN3 - origins_TN3[0], axis=-1) * MM
    return distance_mm


def thing_names(episode: Episode) -> list[str]:
    """Names of the M things of ``Step.contact_AA``: table, robot, objects."""
    return ["table", "rod", *(f"{i + 1} {body.mesh}" for i, body in enumerate(episode.bodies))]


def contact_pairs(episode: Episode) -> list[tuple[int, int]]:
    """The pairs of things that touched at any time, but for objects resting on the table."""
    ever_MM = np.any([step.contact_AA for step in episode.steps], axis=0)
    return [(a, b) for a, b in combinations(range(1, len(ever_MM)), 2) if ever_MM[a, b]]


def plan_svg(episode: Episode) -> str:
    """The table from above, x to the right, y up: hulls at every state, the rod's path, the
    commanded path dashed.
    """
    tips_T3 = np.array([step.tip_world_3 for step in episode.steps])
    commanded_T3 = tips_T3[0] + np.vstack([np.zeros((1, 3)), np.cumsum(episode.actions_T3, axis=0)])
    half = 1.08 * np.nanmax([TABLE_HALF_M, _reach(episode), *np.abs(tips_T3[:, :2]).flat])
    hulls = [
        f'<rect class="hull" data-mark="{step_i}" x="{center[0] - size[0] / 2:.4f}" y="{-center[1] - size[1] / 2:.4f}" '
        f'width="{size[0]:.4f}" height="{size[1]:.4f}" stroke="{object_color(object_i)}"/>'
        for step_i, step in enumerate(episode.steps)
        for object_i, (center, size) in enumerate(zip(step.center_N3, step.size_N3, strict=True))
    ]
    side = 2 * TABLE_HALF_M
    return (
        f'<svg class="plan" width="{PLAN_PX}" height="{PLAN_PX}" viewBox="{-half} {-half} {2 * half} {2 * half}">'
        f'<rect x="{-TABLE_HALF_M}" y="{-TABLE_HALF_M}" width="{side}" height="{side}" class="table"/>'
        f"{''.join(hulls)}{_rod(tips_T3, commanded_T3) if episode.has_robot else ''}</svg>"
    )


def _rod(tips_T3: Floats, commanded_T3: Floats) -> str:
    """The rod's path, the commanded one, and the rod at every state."""
    tips = [
        f'<circle class="tip" data-mark="{step_i}" cx="{tip[0]:.4f}" cy="{-tip[1]:.4f}" r="0.008"/>'
        for step_i, tip in enumerate(tips_T3)
    ]
    return _line(commanded_T3, "commanded") + _line(tips_T3, "rod") + "".join(tips)


def _reach(episode: Episode) -> float:
    """The largest |x| or |y| that a hull attains."""
    edges = [
        np.abs(step.center_N3) + step.size_N3 / 2 for step in episode.steps if len(step.center_N3)
    ]
    return max((float(edge[:, :2].max()) for edge in edges), default=0.0)


def _line(points_T3: Floats, name: str) -> str:
    points = " ".join(f"{x:.4f},{-y:.4f}" for x, y, _ in points_T3)
    return f'<polyline class="{name}" points="{points}"/>'


def displacement_svg(episode: Episode) -> str:
    """Displacement of every object over the states, in millimetres."""
    distance_mm = displacement_mm(episode)
    top = _round_up(float(distance_mm.max(initial=0.0)))
    x = _state_x(len(episode.steps))
    y_of = CHART_HEIGHT_PX - 24 - distance_mm / top * (CHART_HEIGHT_PX - 40)
    base = CHART_HEIGHT_PX - 24
    grid = "".join(
        f'<line x1="{x[0]}" x2="{x[-1]}" y1="{level:.1f}" y2="{level:.1f}" class="grid"/>'
        f'<text x="{x[0] - 8}" y="{level + 4:.1f}" text-anchor="end">{value:g}</text>'
        for value, level in ((0, base), (top / 2, (base + 16) / 2), (top, 16))
    )
    lines = "".join(
        f'<polyline fill="none" stroke="{object_color(i)}" stroke-width="2" '
        f'points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y_of[:, i], strict=True))}"/>'
        for i in range(distance_mm.shape[1])
    )
    return _svg(
        CHART_HEIGHT_PX, grid + lines + _cursor(x, base) + _state_labels(x, CHART_HEIGHT_PX - 6)
    )


def contacts_svg(episode: Episode) -> str:
    """One row a pair of things: a bar over each interval in which they touched."""
    names, pairs, x = thing_names(episode), contact_pairs(episode), _state_x(len(episode.steps))
    rows = []
    for row, (a, b) in enumerate(pairs):
        y = 4 + row * ROW_PX
        label = escape(f"{names[a]} / {names[b]}")
        rows.append(f'<text x="{LABEL_PX - 10}" y="{y + 11}" text-anchor="end">{label}</text>')
        rows += [
            f'<rect x="{x[i - 1] + 1:.1f}" y="{y}" width="{x[i] - x[i - 1] - 2:.1f}" height="{ROW_PX - 6}" '
            f'fill="{object_color(b - 2)}"/>'
            for i, step in enumerate(episode.steps)
            if i and step.contact_AA[a, b]
        ]
    height = 8 + max(1, len(pairs)) * ROW_PX
    nothing = (
        ""
        if pairs
        else f'<text x="{x[0]}" y="15">no contact with the rod, none between objects</text>'
    )
    return _svg(
        height + 18, "".join(rows) + nothing + _cursor(x, height) + _state_labels(x, height + 14)
    )


def _svg(height: float, content: str) -> str:
    return f'<svg class="chart" width="{CHART_WIDTH_PX}" height="{height}">{content}</svg>'


def _state_x(num_steps: int) -> list[float]:
    """The x of each state, shared by the charts, so that they read as one timeline."""
    return [float(x) for x in np.linspace(LABEL_PX, CHART_WIDTH_PX - 20, max(2, num_steps))][
        :num_steps
    ]


def _state_labels(x: list[float], y: float) -> str:
    return "".join(
        f'<text x="{each:.1f}" y="{y}" text-anchor="middle">{i}</text>' for i, each in enumerate(x)
    )


def _cursor(x: list[float], height: float) -> str:
    """A vertical line at each state, of which the page shows the current one."""
    return "".join(
        f'<line class="cursor" data-step="{i}" x1="{each:.1f}" x2="{each:.1f}" y1="2" y2="{height}"/>'
        for i, each in enumerate(x)
    )


def _round_up(value: float) -> float:
    """The next of 1, 2, 4, 5, 10, 20, ... above ``value``."""
    scale = 10.0 ** np.floor(np.log10(max(value, 1.0)))
    return float(next(step * scale for step in (1, 2, 4, 5, 10) if step * scale >= value))
