"""The contact sheet of an episode: ``python -m oes.episodes.sheet EPISODE``.

One HTML file that loads nothing else: the table from above, displacements and contacts, then all
views at every state as colour with the objects' boxes, depth and segmentation.
"""

import argparse
import sys
from base64 import b64encode
from collections.abc import Sequence
from io import BytesIO
from itertools import combinations, product
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from oes.episode import (
    FIRST_OBJECT,
    SEG_FIRST_OBJECT,
    SEG_ROBOT,
    SEG_TABLE,
    Camera,
    Episode,
    Floats,
    Pixels,
)
from oes.episodes.motion import contact_pairs, displacement_mm
from oes.geom.camera import project
from oes.record.errors import EpisodeError
from oes.record.reader import read_episode, read_frames

SEG_COLOURS = {0: "#ffffff", SEG_TABLE: "#d8d2c8", SEG_ROBOT: "#6b6b6b"}
OBJECT_COLOURS = ("#e4572e", "#2878b5", "#5b9a3c", "#d9a400", "#8e5ea2", "#3aa6a0", "#b0416a")
TABLE_M = 0.6
NUM_COLUMNS = 9
CORNERS_83 = np.array(list(product((-0.5, 0.5), repeat=3)))
EDGES = [(a, b) for a, b in combinations(range(8), 2) if a ^ b in (1, 2, 4)]


def write_sheet(folder: Path, out: Path) -> None:
    """Write the contact sheet of an episode (1 to 3 MB). Raises EpisodeError."""
    episode = read_episode(folder)
    frames = [read_frames(folder, step_i, None) for step_i in range(len(episode.steps))]
    depth_m = np.concatenate([each.depth_m_VHW[each.depth_m_VHW > 0] for each in frames])
    near_m, far_m = np.percentile(depth_m, [1, 99]) if depth_m.size else (0.0, 1.0)
    limits = f"depth from {near_m:.2f} m (yellow) to {far_m:.2f} m (dark), white: no return"
    images = [("Motion from above, displacement, contacts", data_uri(charts(episode), "png"))]
    for step_i, (step, views) in enumerate(zip(episode.steps, frames, strict=True)):
        colour = views.rgb_VHW3.copy()
        for image, camera in zip(colour, step.cameras, strict=True):
            draw_boxes(image, camera, step.center_N3, step.size_N3)
            cv2.putText(image, camera.name, (2, 9), cv2.FONT_HERSHEY_PLAIN, 0.7, (255, 255, 255))
        depth = depth_image(views.depth_m_VHW, near_m, far_m)
        images += [
            (f"State {step_i}: colour, boxes of the objects", data_uri(mosaic(colour), "jpeg")),
            (f"State {step_i}: {limits}", data_uri(mosaic(depth), "jpeg")),
            (f"State {step_i}: segmentation", data_uri(mosaic(seg_image(views.seg_VHW)), "png")),
        ]
    x_mm_T, y_mm_T = episode.actions_T3[:, :2].T * 1000
    yaw_deg_T = np.degrees(np.arctan2(y_mm_T, x_mm_T))
    html = render_html(
        "sheet.html.jinja",
        title=f"{episode.task} {episode.split}, episode {episode.index}",
        episode=episode,
        moved_mm_N=displacement_mm(episode, len(episode.steps) - 1),
        actions=np.stack([x_mm_T, y_mm_T, np.hypot(x_mm_T, y_mm_T), yaw_deg_T], axis=1),
        images=images,
    )
    out.write_text(html, encoding="utf-8")


def render_html(template: str, **values: object) -> str:
    """A page from a template of this folder; Jinja escapes every value."""
    loader = FileSystemLoader(Path(__file__).parent)
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template(template).render(values)


def data_uri(image_HW3: Pixels, kind: str, quality: int = 80) -> str:
    """An image as a data URI; "png" is smaller than "jpeg" for few flat colours."""
    data = BytesIO()
    Image.fromarray(image_HW3).save(data, kind, quality=quality)
    return f"data:image/{kind};base64,{b64encode(data.getvalue()).decode()}"


def mosaic(images_VHW3: Pixels) -> Pixels:
    """Views side by side, nine to a row, the last row first: the highest cameras are on top."""
    num_views, height, width, _ = images_VHW3.shape
    num_rows = -(-num_views // NUM_COLUMNS)
    padded = np.full((num_rows * NUM_COLUMNS, height, width, 3), 255, np.uint8)
    padded[:num_views] = images_VHW3
    rows = padded.reshape(num_rows, NUM_COLUMNS, height, width, 3)[::-1]
    return rows.transpose(0, 2, 1, 3, 4).reshape(num_rows * height, NUM_COLUMNS * width, 3)


def draw_boxes(image_HW3: Pixels, camera: Camera, center_N3: Floats, size_N3: Floats) -> None:
    """Draw the edges of world-aligned boxes into an image; none of a box behind the camera."""
    for object_i, (center, size) in enumerate(zip(center_N3, size_N3, strict=True)):
        uv_82, depth_8 = project(camera.K_33, camera.world_T_cam_44, center + size * CORNERS_83)
        if depth_8.min() > 0:
            # The centre of the first pixel is (0.5, 0.5) here and (0, 0) in OpenCV.
            pixels_82 = np.rint(np.clip(uv_82 - 0.5, -1e4, 1e4)).astype(int).tolist()
            for a, b in EDGES:
                cv2.line(image_HW3, pixels_82[a], pixels_82[b], _rgb(_colour(object_i)))


def depth_image(depth_m_VHW: NDArray[np.float32], near_m: float, far_m: float) -> Pixels:
    """Depth as colour V H W 3 from near (yellow) to far (dark); white where nothing returned."""
    share = np.clip((depth_m_VHW - near_m) / max(far_m - near_m, 1e-6), 0, 1)
    colour: Pixels = mpl.colormaps["viridis_r"](share, bytes=True)[..., :3]
    return np.where(depth_m_VHW[..., None] > 0, colour, np.uint8(255))


def seg_image(seg_VHW: Pixels) -> Pixels:
    """Segmentation ids as flat colours V H W 3."""
    objects = {i: _colour(i - SEG_FIRST_OBJECT) for i in range(SEG_FIRST_OBJECT, 256)}
    palette = [_rgb((SEG_COLOURS | objects)[i]) for i in range(256)]
    return np.array(palette, dtype=np.uint8)[seg_VHW]


def charts(episode: Episode) -> Pixels:
    """The table from above, displacement of every object, and contacts by state, H W 3."""
    figure = Figure(figsize=(12, 4), layout="constrained")
    above, displacement, contacts = figure.subplots(1, 3)
    above.set(title="from above, x and y in m", aspect="equal")
    table = Rectangle((-TABLE_M / 2, -TABLE_M / 2), TABLE_M, TABLE_M, color="#f6f3ee")
    above.add_patch(table)
    if episode.has_robot:
        tip_I3 = np.array([step.tip_world_3 for step in episode.steps])
        commanded_I3 = tip_I3[0] + np.cumsum([np.zeros(3), *episode.actions_T3], axis=0)
        above.plot(*commanded_I3[:, :2].T, "--", color="#777", label="rod, commanded")
        above.plot(*tip_I3[:, :2].T, ".-", color="#111", label="rod")
        above.legend(frameon=False, fontsize=7)
    states = range(len(episode.steps))
    displacement.set(title="displacement, mm", xlabel="state")
    for object_i in range(len(episode.bodies)):
        colour = _colour(object_i)
        moved_mm = [displacement_mm(episode, step_i)[object_i] for step_i in states]
        displacement.plot(states, moved_mm, color=colour)
        for step_i, step in enumerate(episode.steps):
            width, height = step.size_N3[object_i, :2]
            x, y = step.center_N3[object_i, :2] - step.size_N3[object_i, :2] / 2
            alpha = (step_i + 1) / len(states)  # later states are darker
            box = Rectangle((x, y), width, height, fill=False, color=colour, alpha=alpha)
            above.add_patch(box)
    above.autoscale_view()
    names = ["table", "rod", *(f"{i + 1} {body.mesh}" for i, body in enumerate(episode.bodies))]
    pairs = contact_pairs(episode)
    contacts.set(title="contacts, except with the table", xlabel="state", xlim=(0, states[-1] or 1))
    labels = [f"{names[a]} / {names[b]}" for a, b in pairs]
    contacts.set_yticks(range(len(pairs)), labels, parse_math=False)  # names are no formulas
    for row, (a, b) in enumerate(pairs):
        spans = [(i - 1, 1) for i in states if i and episode.steps[i].contact_AA[a, b]]
        contacts.broken_barh(spans, (row - 0.3, 0.6), color=_colour(b - FIRST_OBJECT))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def _colour(object_i: int) -> str:
    return OBJECT_COLOURS[object_i % len(OBJECT_COLOURS)]


def _rgb(colour: str) -> list[int]:
    return [round(255 * share) for share in to_rgb(colour)]


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m oes.episodes.sheet", description=__doc__)
    parser.add_argument("episode", type=Path, help="folder of a recorded episode (traj_NNNNNN)")
    parser.add_argument("--out", type=Path, help="HTML file to write (default: NAME.html here)")
    args = parser.parse_args(arguments)
    out = args.out or Path(f"{args.episode.resolve().name}.html")
    try:
        write_sheet(args.episode, out)
    except (EpisodeError, OSError) as error:
        print(f"sheet: {error}", file=sys.stderr)
        return 1
    print(out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
