"""An episode in the browser, with the forecast of a model for the scene and for changes of it.

``python -m oes.apps.view --episode FOLDER`` serves it until ctrl-C (`make view`).
"""

import logging
import threading
from pathlib import Path
from typing import Annotated

import viser

from oes.apps.assets import DATASETS, KEPT, find_catalogue, find_weights
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

RECORDED = Path(".work/view/traj_000000")


@params
class ViewConfig:
    """The section ``view``: the port, and the index of the camera of the input image."""

    port: int
    camera: int


def main(cfg: ViewConfig, episode: Annotated[Path, "folder of an episode"]) -> None:
    """Serve ``episode``; ``RECORDED`` is recorded first if it does not exist.

    Raises WeightsMissing, and EpisodeError for an episode that cannot be read.
    """
    episodes_cfg, catalogue = load(PARAMS, "episodes", EpisodesConfig), find_catalogue()
    if episode == RECORDED:
        record_episode(catalogue, episodes_cfg)
    session = open_session(episode, cfg.camera)
    server = viser.ViserServer(port=cfg.port, label="3D-OES", verbose=False)
    Viewer(server, session, catalogue, episodes_cfg.sim)
    log.info("%s: http://localhost:%d (ctrl-C ends it)", episode, server.get_port())
    threading.Event().wait()


def record_episode(catalogue: Catalogue, cfg: EpisodesConfig) -> None:
    """Record an episode of two objects as ``RECORDED``, unless it exists."""
    if not RECORDED.exists():
        RECORDED.parent.mkdir(parents=True, exist_ok=True)
        capture(catalogue, cfg, PUSHING, "test2", 0, RECORDED)


def open_session(folder: Path, camera_i: int) -> Session:
    """The episode in ``folder`` with the trained weights of the study, or of git."""
    source = FrameSource(folder)
    if not source.episodes:
        raise FileNotFoundError(
            f"{folder}: no episode; expected datasets/episodes/<task>-<split>/traj_<number>"
        )
    perception, dynamics = find_weights((DATASETS, KEPT), (VIEWER_MODEL,), source.episodes[0].task)
    return Session(Perceiver.load(perception), load_model(dynamics[VIEWER_MODEL]), source, camera_i)


if __name__ == "__main__":
    run(main)
