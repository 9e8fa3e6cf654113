"""The viewer: an episode recorded in Bullet, perceived exactly, dragged about; and a real browser
that shows it.
"""

import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import viser

from oes.apps.view import open_session
from oes.apps.viewer.session import Session
from oes.apps.viewer.viewer import Viewer
from oes.config import load
from oes.dynamics.checkpoint import load_model
from oes.episode import Episode
from oes.episodes.capture import capture
from oes.perception.network import SceneFeatures
from oes.perception.perceiver import Perceiver
from oes.record.dataset import FrameSource
from oes.sim.simulate import EpisodesConfig
from tests.blocks import make_catalogue, make_weights, read_sim

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")


class OraclePerceiver(Perceiver):
    """Finds the objects where they truly are."""

    episode: Episode

    def detect(self, scene: SceneFeatures) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        first = self.episode.steps[0]
        center, size = (torch.from_numpy(x).float() for x in (first.center_N3, first.size_N3))
        return center, size, torch.ones(len(center))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A catalogue, weights and one pushing episode."""
    root = tmp_path_factory.mktemp("browse")
    catalogue, cfg = (
        make_catalogue(root / "meshes"),
        load(Path("params.yaml"), "episodes", EpisodesConfig),
    )
    rig = replace(cfg.sim.rig, num_azimuths=1, width_px=64, height_px=64)
    capture(
        catalogue,
        replace(cfg, sim=replace(cfg.sim, rig=rig)),
        "pushing",
        "test2",
        0,
        root / "traj_000000",
    )
    make_weights(root)
    return root


@pytest.fixture
def viewer(folder: Path) -> Viewer:
    perceiver = OraclePerceiver.load(folder / "perception" / "perception.safetensors")
    source = FrameSource(folder / "traj_000000")
    perceiver.episode = source.episodes[0]
    model = load_model(folder / "dynamics" / "pushing-oes")
    server = viser.ViserServer(port=0, verbose=False)
    return Viewer(
        server, Session(perceiver, model, source, 1), make_catalogue(folder / "again"), read_sim()
    )


def wait(is_done: Callable[[], bool], seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not is_done():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def test_a_drag_updates_the_forecast_and_can_be_simulated_and_reset(viewer: Viewer) -> None:
    session, first = viewer.session, viewer.session.first.scene.objects.center_N3.double().numpy()
    viewer.panel.T.value = 0
    viewer.update()
    assert np.asarray(viewer.moving[0].position) == pytest.approx(first[0], abs=1e-5)
    assert "0 mm error" in viewer.panel.status.content and viewer.panel.recorded.visible
    viewer._drag(0, first[0] + np.array([0.03, -0.02, 0.01]))
    wait(lambda: np.allclose(viewer.moving[0].position, first[0] + [0.03, -0.02, 0.0], atol=1e-5))
    wait(lambda: "not simulated yet" in viewer.panel.status.content)
    assert not viewer.true[0].visible and not viewer.panel.recorded.visible
    viewer.simulate()
    wait(lambda: "mm error" in viewer.panel.status.content)
    true = viewer.true[session.first.scene.truth[0]]
    wait(
        lambda: (
            true.visible and np.allclose(true.position, first[0] + [0.03, -0.02, 0.0], atol=1e-3)
        )
    )
    viewer.restore()
    wait(
        lambda: (
            viewer.panel.recorded.visible
            and np.allclose(viewer.moving[0].position, first[0], atol=1e-5)
        )
    )
    assert not session.change.shift_N3.any() and viewer.truth is session.first.episode


def test_the_push_starts_where_it_is_dragged_and_turns_with_its_end(viewer: Viewer) -> None:
    episode = viewer.session.first.episode
    tip_3, way_3 = episode.steps[0].tip_world_3, episode.actions_T3.sum(0)
    viewer.start.position = tip_3 + np.array([0.02, 0.01, 0.0])
    viewer.end.position = viewer.start.position + np.array([-way_3[1], way_3[0], 0.0])
    viewer._drag_push()
    changed = viewer.session.case.episode
    assert changed.steps[0].tip_world_3 == pytest.approx(tip_3 + np.array([0.02, 0.01, 0.0]))
    assert changed.actions_T3.sum(0) == pytest.approx([-way_3[1], way_3[0], 0.0], abs=1e-9)
    wait(lambda: np.allclose(viewer.rod.points[0, 0], changed.steps[0].tip_world_3, atol=1e-5))


def test_a_folder_without_an_episode_is_named(folder: Path) -> None:
    with pytest.raises(FileNotFoundError, match="perception: no episode"):
        open_session(folder / "perception", 1)


@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_a_browser_connects_and_draws(viewer: Viewer, tmp_path: Path) -> None:
    flags = "--headless --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader"
    flags += f" --remote-debugging-port=0 --user-data-dir={tmp_path}"
    command = [str(BROWSER), *flags.split(), f"http://localhost:{viewer.server.get_port()}"]
    browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait(lambda: bool(viewer.server.get_clients()), 90.0)
        (client,) = viewer.server.get_clients().values()
        picture = client.get_render(height=120, width=160)
        assert (
            picture.shape[:2] == (120, 160)
            and len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 20
        )
    finally:
        browser.kill()
        browser.wait()
