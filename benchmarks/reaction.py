"""Milliseconds until the viewer has drawn what a drag changed: to forecast, to decode the picture, and all of it."""

from functools import partial
from pathlib import Path

import torch
import viser

from benchmarks.whole_plan import median_ms
from oes.browse.viewer import Viewer
from oes.capture import capture
from oes.config import load
from oes.demo import find_catalogue
from oes.episode import PUSHING
from oes.sim.simulate import Episodes
from oes.view import SPARE, View, open_session


def main() -> None:
    """Print one line. An episode with two objects is recorded where there is none."""
    cfg, catalogue = load(Path("params.yaml"), "episodes", Episodes), find_catalogue()
    if not SPARE.exists():
        SPARE.parent.mkdir(parents=True, exist_ok=True)
        capture(catalogue, cfg, PUSHING, "test2", 0, SPARE)
    session = open_session(SPARE, load(Path("params.yaml"), "view", View).camera)
    viewer = Viewer(viser.ViserServer(port=0, verbose=False), session, catalogue, cfg.sim)
    case, motion = session.forecast()
    camera = case.episode.steps[0].cameras[0]
    forecast, picture = median_ms(session.forecast), median_ms(partial(session.imagined, case, motion, 5, camera))
    print(f"{'forecast ms':>12}{'picture ms':>12}{'all ms':>12}   ({torch.get_num_threads()} threads)")
    print(f"{forecast:>12.0f}{picture:>12.0f}{median_ms(viewer.update):>12.0f}")


if __name__ == "__main__":
    main()
