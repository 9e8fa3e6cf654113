"""An episode in the browser: what was seen, what is forecast, what happened; objects and the push
can be dragged.

``python -m oes.apps.view --episode FOLDER`` serves it until ctrl-C (`make view`).
"""

import logging
import threading
from pathlib import Path

import viser

from oes.apps.demo import find_catalogue
from oes.apps.evaluate import KEPT, TRAINED, find_weights
from oes.apps.viewer.session import VIEWER_MODEL, Session
from oes.apps.viewer.viewer import Viewer
from oes.cli import run
from oes.config import PARAMS, load, params
from oes.dynamics.checkpoint import load_model
from oes.episode import PUSHING
from oes.episodes.capture import capture
from oes.meshes.catalogue import Catalogue
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.sim.simulate import EpisodesConfig

log = logging.getLogger(__name__)

SPARE = Path(".work/view/traj_000000")


@params
class ViewConfig:
    """The section ``view``: the port where it is served, and the camera of the first photograph."""

    port: int
    camera: int


def main(cfg: ViewConfig, episode: Path) -> None:
    """Serve ``episode``; where it is ``SPARE`` and not there yet, it is recorded first.

    Raises EvaluateError without weights, EpisodeError for an episode that cannot be read.
    """
    episodes_cfg, catalogue = load(PARAMS, "episodes", EpisodesConfig), find_catalogue()
    if episode == SPARE:
        record_spare(catalogue, episodes_cfg)
    session = open_session(episode, cfg.camera)
    server = viser.ViserServer(port=cfg.port, label="3D-OES", verbose=False)
    Viewer(server, session, catalogue, episodes_cfg.sim)
    log.info("%s: http://localhost:%d (ctrl-C ends it)", episode, server.get_port())
    threading.Event().wait()


def record_spare(catalogue: Catalogue, cfg: EpisodesConfig) -> None:
    """An episode of two objects in ``SPARE``, unless one is there."""
    if not SPARE.exists():
        SPARE.parent.mkdir(parents=True, exist_ok=True)
        capture(catalogue, cfg, PUSHING, "test2", 0, SPARE)


def open_session(folder: Path, camera_i: int) -> Session:
    """The episode in ``folder``, with the trained weights, or those in git."""
    source = FrameSource(folder)
    if not source.episodes:
        raise FileNotFoundError(
            f"{folder}: no episode is there; one is a folder datasets/episodes/<split>/traj_<number>"
        )
    perception, dynamics = find_weights((TRAINED, KEPT), (VIEWER_MODEL,), source.episodes[0].task)
    return Session(Perceiver.load(perception), load_model(dynamics[VIEWER_MODEL]), source, camera_i)


if __name__ == "__main__":
    run(main)
