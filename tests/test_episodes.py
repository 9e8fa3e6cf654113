"""Whole episodes: drawn, pushed, replayed and captured on the real simulator, renderer and
recorder.
"""

import json
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from oes.config import load
from oes.episode import Episode
from oes.episodes.capture import Failure, capture_split, episode_folder
from oes.episodes.dataset_card import statistics, write_card
from oes.episodes.motion import displacement_mm, has_object_contact
from oes.geom.boxes import aabb
from oes.geom.se3 import transform
from oes.meshes.catalogue import Catalogue
from oes.record.dataset import read_states
from oes.record.reader import read_episode, read_frames
from oes.sim.scene import SceneRejected
from oes.sim.simulate import EpisodesConfig, count_rejected, replay, replay_bodies, simulate
from tests.test_sim_world import make_meshes

CFG = load(Path("params.yaml"), "episodes", EpisodesConfig)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("study") / "meshes"


@pytest.fixture(scope="module")
def catalogue(folder: Path) -> Catalogue:
    return make_meshes(folder)


@pytest.fixture(scope="module")
def episodes(catalogue: Catalogue) -> list[Episode]:
    return [simulate(catalogue, CFG, "pushing", "test2", index) for index in range(3)]


def states(episode: Episode) -> bytes:
    arrays = [
        value
        for step in episode.steps
        for value in vars(step).values()
        if isinstance(value, np.ndarray)
    ]
    cameras = [camera.world_T_cam_44 for step in episode.steps for camera in step.cameras]
    return b"".join(
        np.ascontiguousarray(array).tobytes() for array in [*arrays, *cameras, episode.actions_T3]
    )


def test_episodes_are_what_the_paper_describes(
    episodes: list[Episode], catalogue: Catalogue
) -> None:
    for episode in episodes:
        lengths = np.linalg.norm(episode.actions_T3, axis=1)
        tips = np.array([step.tip_world_3 for step in episode.steps])
        assert [step.t_ns for step in episode.steps] == [200_000_000 * i for i in range(6)]
        assert ((lengths >= 0.03) & (lengths <= 0.06)).all()
        assert (episode.actions_T3[:, 2] == 0).all()
        assert {catalogue.meshes[body.mesh].split for body in episode.bodies} == {"test"}
        assert np.diff(tips, axis=0) == pytest.approx(episode.actions_T3, abs=3e-3)
        assert episode.rod_rms_m < 3e-3
        assert displacement_mm(episode, 5)[0] > 5
        assert not episode.steps[0].contact_AA.any()
        assert all(len(step.cameras) == 27 for step in episode.steps)


def test_every_true_box_holds_its_posed_mesh(episodes: list[Episode], catalogue: Catalogue) -> None:
    for episode in episodes:
        for step in episode.steps:
            for i, body in enumerate(episode.bodies):
                points = transform(
                    step.world_T_obj_N44[i],
                    catalogue.meshes[body.mesh].visual.vertices * body.scale_3,
                )
                center, size = aabb(points)
                assert np.abs(center - step.center_N3[i]).max() < 1e-9
                assert np.abs(size - step.size_N3[i]).max() < 1e-9
                assert -3e-3 < points[:, 2].min() < 0.02  # contact gives way by a millimetre or two


def test_the_rod_starts_beside_the_first_object(episodes: list[Episode]) -> None:
    for episode in episodes:
        first = episode.steps[0]
        gap = np.abs(first.tip_world_3 - first.center_N3[0])[:2] - first.size_N3[0, :2] / 2
        assert (
            np.hypot(*np.maximum(gap, 0))
            < CFG.pushes.clearance_m[1] + CFG.sim.robot.rod_radius_m + 0.002
        )
        assert any(step.contact_AA[1, 2] for step in episode.steps[1:3])


def test_the_same_seed_gives_the_same_bytes_and_another_differs(
    episodes: list[Episode], catalogue: Catalogue
) -> None:
    assert states(simulate(catalogue, CFG, "pushing", "test2", 1)) == states(episodes[1])
    assert states(simulate(catalogue, replace(CFG, seed=1), "pushing", "test2", 1)) != states(
        episodes[1]
    )
    assert len({states(episode) for episode in episodes}) == len(episodes)


def test_a_replay_is_exact_with_the_true_bodies_and_differs_with_others(
    episodes: list[Episode], catalogue: Catalogue
) -> None:
    for episode in episodes[:1]:
        again = replay_bodies(catalogue, CFG.sim, episode, episode.bodies)
        heavy = replay(catalogue, CFG.sim, episode, mass_kg=0.25, friction=0.1)
        assert states(again) == states(episode)
        assert again.rod_rms_m == episode.rod_rms_m
        assert heavy.steps[0].world_T_obj_N44 == pytest.approx(
            episode.steps[0].world_T_obj_N44, abs=0
        )
        assert np.abs(heavy.steps[-1].center_N3 - episode.steps[-1].center_N3).max() > 1e-4


def test_unknown_tasks_and_impossible_scenes_are_refused(catalogue: Catalogue) -> None:
    with pytest.raises(ValueError, match="unknown task 'juggling'"):
        simulate(catalogue, CFG, "juggling", "train", 0)
    with pytest.raises(KeyError, match="test9"):
        simulate(catalogue, CFG, "pushing", "test9", 0)
    crowded = replace(CFG.pushes, scatter=replace(CFG.pushes.scatter, table_edge_m=0.05))
    with pytest.raises(SceneRejected, match="2 attempts failed; the last: no room"):
        simulate(catalogue, replace(CFG, max_attempts=2, pushes=crowded), "pushing", "test2", 0)


def small(count: int) -> EpisodesConfig:
    """Small pictures from two cameras, in this process."""
    rig = replace(CFG.sim.rig, num_azimuths=2, elevation_deg=(40.0,), width_px=32, height_px=32)
    pushing = {"test2": replace(CFG.splits["pushing"]["test2"], count=count)}
    splits = {**CFG.splits, "pushing": pushing}
    return replace(CFG, sim=replace(CFG.sim, rig=rig), splits=splits, num_workers=1)


def digest(folder: Path) -> str:
    return sha256(
        b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())
    ).hexdigest()


def test_a_split_is_captured_and_resumes_where_it_stopped(
    folder: Path, catalogue: Catalogue, tmp_path: Path
) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert capture_split(folder, small(2), "pushing", "test2", whole) == []
    assert capture_split(folder, small(1), "pushing", "test2", broken) == []
    kept = episode_folder(broken, 0).stat().st_mtime_ns
    (broken / ".traj_000001.tmp").mkdir()  # what a kill leaves
    assert capture_split(folder, small(2), "pushing", "test2", broken) == []
    assert episode_folder(broken, 0).stat().st_mtime_ns == kept
    assert digest(broken) == digest(whole)
    episode = read_episode(episode_folder(whole, 1))
    seg = read_frames(episode_folder(whole, 1), 0, None).seg_VHW
    assert states(episode) == states(simulate(catalogue, small(2), "pushing", "test2", 1))
    assert {1, 2, 3} <= set(np.unique(seg))


def test_a_failing_episode_is_counted_and_the_rest_is_made(
    folder: Path, catalogue: Catalogue, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail_one(
        catalogue: Catalogue, cfg: EpisodesConfig, task: str, split: str, index: int
    ) -> Episode:
        if index == 0:
            raise SceneRejected("nothing stands")
        return simulate(catalogue, cfg, task, split, index)

    monkeypatch.setattr("oes.episodes.capture.simulate", fail_one)
    failures = capture_split(folder, small(2), "pushing", "test2", tmp_path)
    assert failures == [Failure(0, "SceneRejected: nothing stands")]
    made = read_states(tmp_path)
    assert [episode.index for episode in made] == [1]
    card = statistics(made, failures, small(2))
    write_card(card, tmp_path)
    tree = json.loads((tmp_path / "card.json").read_text())
    assert tree["left_out"] == [{"index": 0, "reason": "SceneRejected: nothing stands"}]
    assert "impact" not in tree and set(tree["rod_rms_mm"]) == {"mean", "max"}
    assert "- episode 0: SceneRejected: nothing stands" in (tmp_path / "card.md").read_text()
    first = (tmp_path / "card.png").read_bytes()
    write_card(card, tmp_path)
    assert (tmp_path / "card.png").read_bytes() == first


def test_the_card_counts_what_the_episodes_hold(episodes: list[Episode]) -> None:
    card = statistics(episodes, [], CFG)
    moved = np.concatenate([displacement_mm(episode, 5) for episode in episodes])
    assert card.episodes == len(episodes)
    assert card.objects == {"2": len(episodes)}
    assert card.meshes == {"bowl": len(episodes), "rect": len(episodes)}
    assert card.displacement_mm["5"].mean == pytest.approx(moved.mean())
    touched = [has_object_contact(episode) for episode in episodes]
    assert card.share_object_contact == np.mean(touched)
    assert card.rejected_attempts == sum(count_rejected(episode, CFG) for episode in episodes)
    with pytest.raises(ValueError, match="seed that these params do not give"):
        count_rejected(replace(episodes[0], seed=12345), CFG)
