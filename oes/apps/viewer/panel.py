"""Controls beside the 3D scene."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

HELP = """Drag the handles: one per object, one at the start and one at the end of the push. The
forecast (orange) follows. Blue: boxes perceived in the input image. Green: recorded or simulated
motion. The rendered forecast does not move the arm: it belongs to the background of the input."""
VIEWER_LAYERS = {
    "input": "input image",
    "map": "feature map",
    "perceived": "perceived boxes",
    "forecast": "forecast",
    "truth": "recorded or simulated motion",
}
HIDDEN = ("input", "map")  # until the user shows them


@dataclass(frozen=True)
class Panel:
    """Controls of time and camera, the rendered and recorded images, status, and scene layers."""

    T: viser.GuiSliderHandle[int]
    play: viser.GuiCheckboxHandle
    camera: viser.GuiDropdownHandle[str]
    rendered: viser.GuiImageHandle
    recorded: viser.GuiImageHandle
    status: viser.GuiMarkdownHandle
    simulate: viser.GuiButtonHandle
    restore: viser.GuiButtonHandle
    layers: dict[str, viser.GuiCheckboxHandle]


def make_panel(gui: viser.GuiApi, cameras: Sequence[str], camera_i: int, num_steps: int) -> Panel:
    """The controls of an episode of ``num_steps`` steps, without their callbacks."""
    gui.configure_theme(control_width="large", show_share_button=False)
    gui.main_panel.dock_right()
    gui.add_markdown(HELP)
    blank = np.zeros((8, 8, 3), np.uint8)
    T = gui.add_slider("T (steps)", 0, num_steps, 1, num_steps, marks=tuple(range(num_steps + 1)))
    play = gui.add_checkbox("play", False)
    camera = gui.add_dropdown("camera", cameras, initial_value=cameras[camera_i])
    rendered, recorded = (
        gui.add_image(blank, label="rendered forecast"),
        gui.add_image(blank, label="recorded image at T"),
    )
    status = gui.add_markdown("")
    simulate, restore = gui.add_button("simulate this change"), gui.add_button("reset")
    with gui.add_folder("show"):
        layers = {
            name: gui.add_checkbox(label, name not in HIDDEN)
            for name, label in VIEWER_LAYERS.items()
        }
    return Panel(T, play, camera, rendered, recorded, status, simulate, restore, layers)
