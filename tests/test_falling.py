"""Falling episodes on the real simulator: drawn, dropped, replayed, captured and described."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from oes.config import load
from oes.episode import SEG_FIRST_OBJECT, SEG_ROBOT, Episode
from oes.episodes.capture import capture_split, episode_folder
from oes.episodes.dataset_card import statistics, write_card
from oes.episodes.motion import impact_T
from oes.episodes.sheet import write_sheet
from oes.geom.se3 import transform
from oes.meshes.catalogue import BLOCK, Catalogue, CatalogueError, save_catalogue, write_mesh
from oes.meshes.draft import Draft, StandConfig, placed
from oes.record.check import check_episode
from oes.record.reader import read_episode, read_frames
from oes.sim.simulate import EpisodesConfig, replay, replay_bodies, simulate
from tests.test_episodes import states

CFG = load(Path("params.yaml"), "episodes", EpisodesConfig)
GRAVITY_M_S2 = 9.81


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study") / "meshes"


@pytest.fixture(scope="module")
def catalogue(folder: Path) -> Catalogue:
    """Blocks of both splits, and a mug's worth of something that is only pushed."""
    sizes = {
        "cube": (1, 1, 1),
        "slab": (2, 1, 1),
        "tower": (1, 1, 2),
        "brick": (2, 1, 0.5),
        "pushed": (1, 2, 1),
    }
    for name, size in sizes.items():
        solid = trimesh.creation.box(0.045 * np.array(size))
        category = "toy" if name == "pushed" else BLOCK
        draft = Draft(name, category, "test", "made", solid, (solid,))
        longest_m = 0.045 * max(size[:2])
        write_mesh(
            *placed(draft, longest_m, StandConfig(max_aspect=6.0, max_tilt_deg=15.0)), folder / name
        )
    return save_catalogue(
        folder, {name: "train" if name == "cube" else "test" for name in sizes}, []
    )


@pytest.fixture(scope="module")
def episodes(catalogue: Catalogue) -> list[Episode]:
    return [simulate(catalogue, CFG, "falling", "test3", index) for index in range(4)]


def lowest_m(episode: Episode, catalogue: Catalogue, T: int) -> float:
    body = episode.bodies[-1]
    points = catalogue.meshes[body.mesh].visual.vertices * body.scale_3
    return float(transform(episode.steps[T].world_T_obj_N44[-1], points)[:, 2].min())


def test_tasks_share_no_mesh(catalogue: Catalogue) -> None:
    assert [mesh.id for mesh in catalogue.split("test", "pushing")] == ["pushed"]
    assert [mesh.id for mesh in catalogue.split("test", "falling")] == ["slab", "tower", "brick"]
    with pytest.raises(CatalogueError, match="pushing"):
        catalogue.split("train", "pushing")


def test_the_last_object_starts_at_rest_in_the_air_and_the_others_stand(
    episodes: list[Episode], catalogue: Catalogue
) -> None:
    for episode in episodes:
        assert (episode.task, len(episode.bodies), len(episode.steps)) == ("falling", 3, 6)
        assert [step.t_ns for step in episode.steps] == [40_000_000 * i for i in range(6)]
        assert not episode.actions_T3.any() and not episode.has_robot
        assert np.isnan(episode.steps[0].tip_world_3).all() and np.isnan(episode.rod_rms_m)
        assert lowest_m(episode, catalogue, 0) > CFG.falls.gap_m[0] - 1e-6
        standing = episode.steps[0].center_N3[:-1, 2] - episode.steps[0].size_N3[:-1, 2] / 2
        assert np.abs(standing).max() < 2e-3
        assert (episode.steps[0].center_N3 + episode.steps[0].size_N3 / 2)[
            :, 2
        ].max() < CFG.falls.ceiling_m + 2e-3


def test_it_falls_freely_until_it_meets_something_and_is_then_stopped(
    episodes: list[Episode], catalogue: Catalogue
) -> None:
    for episode in episodes:
        first = impact_T(episode)
        heights = np.array([step.world_T_obj_N44[-1, 2, 3] for step in episode.steps])
        for T in range(1, first if first is not None else len(episode.steps)):
            t_s = episode.steps[T].t_ns / 1e9
            # Bullet's semi-implicit steps of 4 ms fall a little faster than the parabola.
            assert heights[0] - heights[T] == pytest.approx(GRAVITY_M_S2 * t_s**2 / 2, rel=0.15)
        assert all(lowest_m(episode, catalogue, T) > -6e-3 for T in range(6))
    assert any(impact_T(episode) is not None for episode in episodes)


def test_the_same_seed_gives_the_same_bytes_and_a_replay_is_exact(
    episodes: list[Episode], catalogue: Catalogue
) -> None:
    assert states(simulate(catalogue, CFG, "falling", "test3", 1)) == states(episodes[1])
    assert len({states(episode) for episode in episodes}) == len(episodes)
    again = replay_bodies(catalogue, CFG.sim, episodes[1], episodes[1].bodies)
    assert states(again) == states(episodes[1])
    heavy = replay(catalogue, CFG.sim, episodes[1], mass_kg=0.25, friction=0.05)
    assert [step.t_ns for step in heavy.steps] == [step.t_ns for step in episodes[1].steps]


def test_a_falling_split_is_captured_without_a_robot_and_described(
    folder: Path, catalogue: Catalogue, tmp_path: Path
) -> None:
    rig = replace(CFG.sim.rig, num_azimuths=2, elevation_deg=(40.0,), width_px=32, height_px=32)
    falling = {"test4": replace(CFG.splits["falling"]["test4"], count=2)}
    cfg = replace(
        CFG, sim=replace(CFG.sim, rig=rig), splits={**CFG.splits, "falling": falling}, num_workers=1
    )  # fmt: skip
    assert capture_split(folder, cfg, "falling", "test4", tmp_path) == []
    path = episode_folder(tmp_path, 0)
    check_episode(path)
    recorded = [read_episode(episode_folder(tmp_path, i)) for i in range(2)]
    assert states(recorded[0]) == states(simulate(catalogue, cfg, "falling", "test4", 0))
    seen = set(np.unique(read_frames(path, 0, None).seg_VHW).tolist())
    assert SEG_ROBOT not in seen and SEG_FIRST_OBJECT + 3 in seen
    write_sheet(path, tmp_path / "sheet.html")
    assert "no robot" in (tmp_path / "sheet.html").read_text()
    card = statistics(recorded, [], cfg)
    assert list(card.impact or {}) == ["1", "2", "3", "4", "5"]
    write_card(card, tmp_path)
    assert "rod_rms_mm" not in json.loads((tmp_path / "card.json").read_text())
    assert "The falling object has touched something in" in (tmp_path / "card.md").read_text()
