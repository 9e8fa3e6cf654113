"""A contact sheet of one episode, one HTML file that needs nothing else: ``python -m
oes.record.sheet EPISODE``.

All views of a state with colour, depth or segmentation and the boxes of the objects; a slider moves
through the states; the table from above, displacements and contacts follow it.
"""

import argparse
import sys
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from oes.episode import Episode, Frames, Step
from oes.record.charts import MM, contacts_svg, displacement_mm, displacement_svg, plan_svg
from oes.record.page import SHEET_SCRIPT, page
from oes.record.pictures import (
    box_path,
    depth_picture,
    jpeg_uri,
    mosaic,
    object_color,
    place,
    png_uri,
    seg_picture,
)
from oes.record.reader import read_episode, read_frames

COLOR_QUALITY, DEPTH_QUALITY = 82, 75
PLAN_CAPTION = "The table from above; the rod, if there is one: black; as commanded: dashed."
LAYERS = ("colour", "depth", "segmentation")


def episode_sheet(folder: Path) -> str:
    """The HTML of an episode's contact sheet (1 to 3 MB at 27 views of 128 x 128). Raises
    EpisodeError.
    """
    episode = read_episode(folder)
    frames = [read_frames(folder, step_i, None) for step_i in range(len(episode.steps))]
    title = f"{episode.task} {episode.split}, episode {episode.index}"
    body = f"""
<header><h1>{escape(title)}</h1><p>{_summary(episode)}</p></header>
<section class="controls">
  <label>state <input type="range" id="step" min="0" max="{len(episode.steps) - 1}" value="0">
  <output id="now">0</output></label>
  <span class="layers">{"".join(_layer_button(name) for name in LAYERS)}</span>
  <label><input type="checkbox" id="boxes" checked> boxes</label>
</section>
<section class="views">{_views(episode, frames)}</section>
<section class="charts">
  <figure>{plan_svg(episode)}<figcaption>{PLAN_CAPTION}</figcaption></figure>
  <figure>{displacement_svg(episode)}<figcaption>Displacement of each object (mm) by state.</figcaption>
  {contacts_svg(episode)}<figcaption>Contacts since the state before.</figcaption></figure>
  <figure>{_bodies_table(episode)}</figure>
</section>
{_actions_table(episode) if episode.has_robot else ""}"""
    return page(title, body, SHEET_SCRIPT)


def _summary(episode: Episode) -> str:
    duration_s = episode.steps[-1].t_ns / 1e9
    rod = f"rod {episode.rod_rms_m * MM:.1f} mm RMS from its commanded path"
    return (
        f"{len(episode.bodies)} objects, {len(episode.steps)} states over {duration_s:g} s, "
        f"{len(episode.steps[0].cameras)} cameras, seed {episode.seed}, "
        f"{rod if episode.has_robot else 'no robot'}"
    )


def _layer_button(name: str) -> str:
    checked = " checked" if name == LAYERS[0] else ""
    return f'<label><input type="radio" name="layer" value="{name}"{checked}> {name}</label>'


def _views(episode: Episode, frames: Sequence[Frames]) -> str:
    """The mosaics of every state and layer, of which the page shows one, under one drawing of boxes
    per state.
    """
    returns = np.concatenate([each.depth_m_VHW[each.depth_m_VHW > 0] for each in frames])
    near_m, far_m = np.percentile(returns, [1, 99]) if returns.size else (0.0, 1.0)
    images = []
    for step_i, each in enumerate(frames):
        uris = (
            jpeg_uri(mosaic(each.rgb_VHW3), COLOR_QUALITY),
            jpeg_uri(mosaic(depth_picture(each.depth_m_VHW, near_m, far_m)), DEPTH_QUALITY),
            png_uri(mosaic(seg_picture(each.seg_VHW))),
        )
        images += [
            f'<img data-step="{step_i}" data-layer="{layer}" src="{uri}" alt="{layer} of state {step_i}">'
            for layer, uri in zip(LAYERS, uris, strict=True)
        ]
    height, width = mosaic(frames[0].rgb_VHW3).shape[:2]
    overlay = "".join(_boxes(step_i, step) for step_i, step in enumerate(episode.steps)) + _names(
        episode.steps[0]
    )
    return (
        f'<div class="mosaic">{"".join(images)}<svg viewBox="0 0 {width} {height}">{overlay}</svg></div>'
        f"<p class='note'>Depth from {near_m:.2f} m (yellow) to {far_m:.2f} m (dark), white where nothing returned.</p>"
    )


def _boxes(step_i: int, step: Step) -> str:
    size_px = step.cameras[0].width_px, step.cameras[0].height_px
    corners = [place(view_i, len(step.cameras), size_px) for view_i in range(len(step.cameras))]
    paths = []
    for object_i, (center, size) in enumerate(zip(step.center_N3, step.size_N3, strict=True)):
        edges = "".join(
            box_path(camera, at, center, size)
            for camera, at in zip(step.cameras, corners, strict=True)
        )
        paths.append(f'<path d="{edges}" stroke="{object_color(object_i)}"/>')
    return f'<g class="boxes" data-step="{step_i}">{"".join(paths)}</g>'


def _names(step: Step) -> str:
    size_px = step.cameras[0].width_px, step.cameras[0].height_px
    places = [place(view_i, len(step.cameras), size_px) for view_i in range(len(step.cameras))]
    return "".join(
        f'<text x="{x + 4}" y="{y + 12}">{escape(camera.name)}</text>'
        for camera, (x, y) in zip(step.cameras, places, strict=True)
    )


def _bodies_table(episode: Episode) -> str:
    moved_mm = displacement_mm(episode)[-1]
    rows = "".join(
        f'<tr><td><b style="color:{object_color(i)}">■</b> {i + 1} {escape(body.mesh)}</td>'
        f"<td>{escape(body.category)}</td><td>{' '.join(f'{scale:.2f}' for scale in body.scale_3)}</td>"
        f"<td>{body.mass_kg:.3f}</td><td>{body.friction:.2f}</td><td>{moved_mm[i]:.0f}</td></tr>"
        for i, body in enumerate(episode.bodies)
    )
    head = "<tr><th>object</th><th>category</th><th>scale x y z</th><th>kg</th><th>friction</th><th>moved mm</th></tr>"
    return f"<table>{head}{rows}</table>"


def _actions_table(episode: Episode) -> str:
    rows = "".join(
        f"<tr data-mark='{i}'><td>{i} → {i + 1}</td><td>{x * MM:.1f}</td><td>{y * MM:.1f}</td>"
        f"<td>{np.hypot(x, y) * MM:.1f}</td><td>{np.degrees(np.arctan2(y, x)):.0f}°</td></tr>"
        for i, (x, y, _) in enumerate(episode.actions_T3)
    )
    head = "<tr><th>states</th><th>x mm</th><th>y mm</th><th>length mm</th><th>heading</th></tr>"
    return f"<section><h2>Actions</h2><table>{head}{rows}</table></section>"


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; the exit status."""
    parser = argparse.ArgumentParser(prog="python -m oes.record.sheet", description=__doc__)
    parser.add_argument("episode", type=Path)
    parser.add_argument(
        "--out", type=Path, help="the HTML file (default: EPISODE's name in the working directory)"
    )
    args = parser.parse_args(arguments)
    out = args.out if args.out is not None else Path(f"{args.episode.resolve().name}.html")
    out.write_text(episode_sheet(args.episode), encoding="utf-8")
    print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
