"""Reaction time (ms) of the viewer to a drag: forecast, decoded image, and total."""

from functools import partial

import torch
import viser

from benchmarks.whole_plan import median_ms
from oes.apps.assets import find_catalogue
from oes.apps.view import RECORDED, ViewConfig, open_session, record_episode
from oes.apps.viewer.viewer import Viewer
from oes.config import PARAMS, load
from oes.sim.simulate import EpisodesConfig


def main() -> None:
    """Print one line. Records an episode with two objects if there is none."""
    cfg, catalogue = load(PARAMS, "episodes", EpisodesConfig), find_catalogue()
    record_episode(catalogue, cfg)
    session = open_session(RECORDED, load(PARAMS, "view", ViewConfig).camera)
    viewer = Viewer(viser.ViserServer(port=0, verbose=False), session, catalogue, cfg.sim)
    scenario, motion = session.forecast()
    camera = scenario.episode.steps[0].cameras[0]
    forecast_ms = median_ms(session.forecast)
    image_ms = median_ms(partial(session.render, scenario, motion, 5, camera))
    header = f"{'forecast ms':>12}{'image ms':>12}{'total ms':>12}"
    print(f"{header}   ({torch.get_num_threads()} threads)")
    print(f"{forecast_ms:>12.0f}{image_ms:>12.0f}{median_ms(viewer.update):>12.0f}")


if __name__ == "__main__":
    main()
