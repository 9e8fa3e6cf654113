"""The controls beside a session's scene in the browser."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

HELP = """Drag the handles: objects, where the rod starts, where it goes. The forecast (orange) follows.
Blue: seen in the first photograph. Green: what happened, or would (simulate)."""
VIEWER_LAYERS = {
    "photograph": "first photograph",
    "map": "feature map",
    "seen": "objects seen",
    "forecast": "forecast",
    "truth": "what happened",
}
HIDDEN = ("photograph", "map")  # at first


@dataclass(frozen=True)
class Panel:
    """Time, camera, the two pictures, what is told of the forecast, and which layers of the scene
    are shown.
    """

    T: viser.GuiSliderHandle[int]
    play: viser.GuiCheckboxHandle
    camera: viser.GuiDropdownHandle[str]
    imagined: viser.GuiImageHandle
    photograph: viser.GuiImageHandle
    status: viser.GuiMarkdownHandle
    simulate: viser.GuiButtonHandle
    restore: viser.GuiButtonHandle
    layers: dict[str, viser.GuiCheckboxHandle]


def make_panel(gui: viser.GuiApi, cameras: Sequence[str], camera_i: int, num_steps: int) -> Panel:
    """The controls of an episode of so many steps; nothing happens yet when they are used."""
    gui.configure_theme(control_width="large", show_share_button=False)
    gui.main_panel.dock_right()
    gui.add_markdown(HELP)
    blank = np.zeros((8, 8, 3), np.uint8)
    T = gui.add_slider("T (steps)", 0, num_steps, 1, num_steps, marks=tuple(range(num_steps + 1)))
    play = gui.add_checkbox("play", False)
    camera = gui.add_dropdown("camera", cameras, initial_value=cameras[camera_i])
    imagined, photograph = (
        gui.add_image(blank, label="imagined"),
        gui.add_image(blank, label="photograph at T"),
    )
    status = gui.add_markdown("")
    simulate, restore = gui.add_button("simulate this change"), gui.add_button("as it was")
    with gui.add_folder("show"):
        layers = {
            name: gui.add_checkbox(label, name not in HIDDEN)
            for name, label in VIEWER_LAYERS.items()
        }
    return Panel(T, play, camera, imagined, photograph, status, simulate, restore, layers)
