"""An episode on disk is the episode in memory, whole, exact and always the same bytes."""

from dataclasses import fields, is_dataclass, replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

from oes.episode import Frames
from oes.record import EpisodeError, list_episodes, read_episode, read_frames, write_episode
from oes.record.dataset import FrameSource
from tests.factories import make_episode, make_frames


@pytest.fixture(scope="module")
def split(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes, written out of order, and things that are none."""
    folder = tmp_path_factory.mktemp("pushing-train")
    for index in (2, 0, 1):
        episode = make_episode(seed=index)
        write_episode(episode, make_frames(episode, seed=index), folder / f"traj_{index:06d}")
    (folder / ".traj_000009.tmp").mkdir()
    (folder / "card.json").write_text("{}")
    return folder


def assert_equal(a: object, b: object) -> None:
    """Equal to the last bit, dtypes and shapes included."""
    assert type(a) is type(b)
    if is_dataclass(a):
        for field in fields(a):
            assert_equal(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and a.shape == b.shape and np.array_equal(a, b)
    elif isinstance(a, tuple):
        assert len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            assert_equal(one, other)
    else:
        assert a == b


def test_episode_comes_back_exactly(split: Path) -> None:
    for index, folder in enumerate(list_episodes(split)):
        assert_equal(read_episode(folder), make_episode(seed=index))


def test_frames_come_back_exactly(split: Path) -> None:
    frames = make_frames(make_episode(seed=1), seed=1)
    folder = split / "traj_000001"
    assert_equal(read_frames(folder, 2, None), frames[2])
    chosen = read_frames(folder, 0, [26, 3, 3])
    assert np.array_equal(chosen.rgb_VHW3, frames[0].rgb_VHW3[[26, 3, 3]])
    assert np.array_equal(chosen.depth_m_VHW, frames[0].depth_m_VHW[[26, 3, 3]])
    assert np.array_equal(chosen.seg_VHW, frames[0].seg_VHW[[26, 3, 3]])


def test_depth_is_rounded_to_millimetres(tmp_path: Path) -> None:
    episode = make_episode(num_steps=1)
    [frames] = make_frames(episode)
    exact = replace(frames, depth_m_VHW=frames.depth_m_VHW + np.float32(0.0003))
    write_episode(episode, [exact], tmp_path / "traj_000000")
    assert np.array_equal(
        read_frames(tmp_path / "traj_000000", 0, None).depth_m_VHW, frames.depth_m_VHW
    )


def test_episode_without_objects_or_actions(tmp_path: Path) -> None:
    episode = make_episode(num_steps=1, num_objects=0)
    write_episode(episode, make_frames(episode), tmp_path / "traj_000000")
    assert_equal(read_episode(tmp_path / "traj_000000"), episode)


def test_same_episode_same_bytes(split: Path, tmp_path: Path) -> None:
    def digest(folder: Path) -> dict[str, str]:
        return {path.name: sha256(path.read_bytes()).hexdigest() for path in folder.iterdir()}

    again = {}
    for seed in (1, 2):
        episode = make_episode(seed=seed)
        folder = tmp_path / str(seed) / "traj_000001"
        write_episode(episode, make_frames(episode, seed=seed), folder)
        again[seed] = digest(folder)
    assert again[1] == digest(split / "traj_000001")
    assert again[2]["traj_000001_0.mcap"] != again[1]["traj_000001_0.mcap"]


def test_listing_is_sorted_and_holds_episodes_only(split: Path) -> None:
    assert [path.name for path in list_episodes(split)] == [
        "traj_000000",
        "traj_000001",
        "traj_000002",
    ]


def test_folder_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    episode = make_episode()
    frames = make_frames(episode)
    folder = tmp_path / "traj_000000"
    with pytest.raises(ValueError, match="zip"):
        write_episode(episode, frames[:2], folder)
    assert list(tmp_path.iterdir()) == []
    write_episode(episode, frames, folder)
    assert [path.name for path in tmp_path.iterdir()] == ["traj_000000"]
    with pytest.raises(FileExistsError, match="traj_000000"):
        write_episode(episode, frames, folder)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda f: replace(f, depth_m_VHW=f.depth_m_VHW * np.nan), "depth"),
        (lambda f: replace(f, depth_m_VHW=f.depth_m_VHW + 70), "depth"),
        (lambda f: replace(f, seg_VHW=f.seg_VHW[:5]), "cameras"),
        (lambda f: Frames(f.rgb_VHW3[:, :8], f.depth_m_VHW[:, :8], f.seg_VHW[:, :8]), "cameras"),
    ],
)
def test_images_that_cannot_be_recorded_are_refused(damage, reason: str, tmp_path: Path) -> None:
    episode = make_episode(num_steps=1)
    with pytest.raises(ValueError, match=reason):
        write_episode(
            episode, [damage(frames) for frames in make_frames(episode)], tmp_path / "traj_000000"
        )


def test_episodes_that_contradict_themselves_are_refused(tmp_path: Path) -> None:
    episode = make_episode()
    first, second, third = episode.steps
    renamed = replace(
        second, cameras=tuple(replace(camera, name="cam_00") for camera in second.cameras)
    )
    for wrong, reason in [
        (replace(episode, steps=(first, renamed, third)), "cameras"),
        (replace(episode, steps=(first, third, second)), "times"),
        (replace(episode, actions_T3=episode.actions_T3[:1]), "actions"),
    ]:
        with pytest.raises(ValueError, match=reason):
            write_episode(wrong, make_frames(episode), tmp_path / "traj_000000")


def test_missing_states_and_cameras_are_refused(split: Path) -> None:
    for step_i, camera_i in [(3, 0), (-1, 0), (0, 27), (0, -1)]:
        with pytest.raises(EpisodeError, match=r"no state|no camera"):
            read_frames(split / "traj_000000", step_i, [camera_i])


def test_frame_source_reads_images_and_their_cameras(split: Path) -> None:
    source = FrameSource(split)
    frames, cameras = source.read(2, 1, [4, 20])
    assert len(source) == 3
    assert np.array_equal(
        frames.rgb_VHW3, make_frames(make_episode(seed=2), seed=2)[1].rgb_VHW3[[4, 20]]
    )
    assert_equal(cameras, tuple(make_episode(seed=2).steps[1].cameras[i] for i in (4, 20)))
