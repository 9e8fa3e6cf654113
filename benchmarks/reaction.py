"""Milliseconds until the viewer has drawn what a drag changed: to forecast, to decode the picture,
and all of it.
"""

from functools import partial

import torch
import viser

from benchmarks.whole_plan import median_ms
from oes.apps.assets import find_catalogue
from oes.apps.view import RECORDED, ViewConfig, open_session, record_episode
from oes.apps.viewer.viewer import Viewer
from oes.config import load
from oes.sim.simulate import EpisodesConfig
from oes.config import PARAMS


def main() -> None:
    """Print one line. An episode with two objects is recorded where there is none."""
    cfg, catalogue = load(PARAMS, "episodes", EpisodesConfig), find_catalogue()
    record_episode(catalogue, cfg)
    session = open_session(RECORDED, load(PARAMS, "view", ViewConfig).camera)
    viewer = Viewer(viser.ViserServer(port=0, verbose=False), session, catalogue, cfg.sim)
    case, motion = session.forecast()
    camera = case.episode.steps[0].cameras[0]
    forecast, picture = (
        median_ms(session.forecast),
        median_ms(partial(session.render, case, motion, 5, camera)),
    )
    print(
        f"{'forecast ms':>12}{'picture ms':>12}{'all ms':>12}   ({torch.get_num_threads()} threads)"
    )
    print(f"{forecast:>12.0f}{picture:>12.0f}{median_ms(viewer.update):>12.0f}")


if __name__ == "__main__":
    main()
