"""Damaged files: never silently wrong, never hungry, as much as possible recovered."""

import os
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from oes.record import EpisodeError, list_episodes, read_episode, read_frames, write_episode
from oes.record.check import check_episode
from oes.record.doctor import find_episodes, limited_memory, main
from oes.record.recover import recover
from tests.factories import make_episode, make_frames
from tests.test_record_episode import assert_equal

NUM_FLIPS = 150


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sound episode of three states."""
    folder = tmp_path_factory.mktemp("sound") / "traj_000000"
    episode = make_episode()
    write_episode(episode, make_frames(episode), folder)
    return folder


@pytest.fixture
def damaged(sound: Path, tmp_path: Path) -> Path:
    """A copy of it, to damage."""
    return Path(shutil.copytree(sound, tmp_path / sound.name))


def bag_of(folder: Path) -> Path:
    [path] = folder.glob("*.mcap")
    return path


def chunk_heads(data: bytes) -> list[int]:
    """Where each chunk record begins: 41 bytes before its compression's name (which the summary
    repeats).
    """
    names = [match.start() for match in re.finditer(b"zstd", data)]
    return [name - 41 for name in names[: len(names) // 2]]


def flip(path: Path, sound: bytes, bit: int) -> None:
    damaged = bytearray(sound)
    damaged[bit // 8] ^= 1 << bit % 8
    path.write_bytes(damaged)


def test_a_sound_episode_passes(sound: Path) -> None:
    check_episode(sound)


def test_an_episode_of_one_state_passes(tmp_path: Path) -> None:
    """Its topic of actions has no message."""
    episode = make_episode(num_steps=1)
    write_episode(episode, make_frames(episode), tmp_path / "traj_000000")
    check_episode(tmp_path / "traj_000000")


def test_no_flipped_bit_is_silently_wrong(damaged: Path) -> None:
    """The check finds every flip; a plain read raises or returns the truth; neither maps 200 MB
    more.
    """
    path = bag_of(damaged)
    data = path.read_bytes()
    truth, images = make_episode(), make_frames(make_episode())[1]
    rng = np.random.default_rng(0)
    ends = np.concatenate([np.arange(300), 8 * len(data) - 1 - np.arange(300)])
    bits = np.concatenate(
        [rng.integers(0, 8 * len(data), NUM_FLIPS), rng.choice(ends, NUM_FLIPS // 3)]
    )
    with limited_memory(200 << 20):
        for bit in bits.tolist():
            flip(path, data, bit)
            with pytest.raises(EpisodeError):
                check_episode(damaged)
            try:
                assert_equal(read_episode(damaged), truth)
                assert_equal(read_frames(damaged, 1, None), images)
            except EpisodeError as error:
                assert error.path == path


def test_flipped_lengths_allocate_nothing(damaged: Path) -> None:
    """High bits of the sizes in the first chunk's record, head and zstd frame: refused before any
    allocation.
    """
    path = bag_of(damaged)
    data = path.read_bytes()
    chunk = chunk_heads(data)[0]
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for byte in [
        *range(chunk + 1, chunk + 9),
        *range(chunk + 25, chunk + 33),
        *range(chunk + 45, chunk + 70),
    ]:
        flip(path, data, 8 * byte + 7)
        for attempt in (
            check_episode,
            read_episode,
            lambda folder: recover(folder, folder.parent / "traj_out"),
        ):
            with pytest.raises(EpisodeError):
                attempt(damaged)
            shutil.rmtree(damaged.parent / "traj_out", ignore_errors=True)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100 << 10


@pytest.mark.parametrize("share", [0.0, 0.0001, 0.3, 0.6, 0.95, 0.9999])
def test_truncated_files_are_refused(damaged: Path, share: float) -> None:
    path = bag_of(damaged)
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    for attempt in (check_episode, read_episode, lambda folder: read_frames(folder, 0, [0])):
        with pytest.raises(EpisodeError, match="truncated") as caught:
            attempt(damaged)
        assert caught.value.path == path


def test_truncated_file_is_recovered_up_to_its_last_whole_state(
    damaged: Path, tmp_path: Path
) -> None:
    path = bag_of(damaged)
    path.write_bytes(path.read_bytes()[: int(0.8 * path.stat().st_size)])
    out = tmp_path / "rescued" / "traj_000000"
    kept = recover(damaged, out)
    assert 1 <= kept.steps < kept.expected_steps == 3
    assert 0 < kept.messages < kept.expected_messages
    check_episode(out)
    assert_equal(read_episode(out).steps, make_episode().steps[: kept.steps])
    assert_equal(
        read_frames(out, kept.steps - 1, None), make_frames(make_episode())[kept.steps - 1]
    )


def test_recovering_a_sound_file_gives_the_same_bytes(sound: Path, tmp_path: Path) -> None:
    kept = recover(sound, tmp_path / sound.name)
    assert (kept.steps, kept.messages) == (kept.expected_steps, kept.expected_messages)
    assert bag_of(tmp_path / sound.name).read_bytes() == bag_of(sound).read_bytes()


def test_damage_in_the_last_images_costs_only_the_last_state(damaged: Path, tmp_path: Path) -> None:
    path = bag_of(damaged)
    data = path.read_bytes()
    flip(path, data, 8 * (chunk_heads(data)[-1] + 600))
    assert_equal(read_episode(damaged), make_episode())
    with pytest.raises(EpisodeError, match=r"checksum|Zstd|claims"):
        read_frames(damaged, 2, None)
    assert recover(damaged, tmp_path / "out" / "traj_000000").steps == 2


def test_lost_states_cannot_be_recovered(damaged: Path, tmp_path: Path) -> None:
    path = bag_of(damaged)
    data = path.read_bytes()
    flip(path, data, 8 * (chunk_heads(data)[0] + 600))
    with pytest.raises(EpisodeError, match="/episode"):
        recover(damaged, tmp_path / "out" / "traj_000000")
    assert not (tmp_path / "out").exists()


def test_foreign_and_missing_files_are_named(damaged: Path, tmp_path: Path) -> None:
    path = bag_of(damaged)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("oes_msgs/msg/EpisodeInfo", "ros2msg", b"string task\n")
        channel = writer.register_channel("/episode", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0", 1)
        writer.finish()
    with pytest.raises(
        EpisodeError, match="the type of /episode is not our oes_msgs/msg/EpisodeInfo"
    ):
        read_episode(damaged)
    path.unlink()
    with pytest.raises(EpisodeError, match="0 MCAP files"):
        read_episode(damaged)
    with pytest.raises(EpisodeError, match="traj_none"):
        read_episode(tmp_path / "traj_none")


def test_metadata_must_describe_the_file(damaged: Path) -> None:
    metadata = damaged / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 3", "message_count: 4", 1))
    with pytest.raises(EpisodeError, match=r"metadata\.yaml"):
        check_episode(damaged)
    metadata.unlink()
    with pytest.raises(EpisodeError, match=r"metadata\.yaml"):
        check_episode(damaged)


def test_doctor_names_the_broken_and_recovers_them(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    split = tmp_path / "pushing-train"
    for index in range(3):
        copy = Path(shutil.copytree(sound, split / f"traj_{index:06d}"))
        (copy / "traj_000000_0.mcap").rename(copy / "traj_000000_0.mcap")
    path = bag_of(split / "traj_000001")
    path.write_bytes(path.read_bytes()[: int(0.8 * path.stat().st_size)])
    assert main([str(tmp_path), "--jobs", "1", "--recover", str(tmp_path / "rescued")]) == 1
    report = capsys.readouterr().out
    assert "traj_000001" in report and "truncated" in report and "of 3 states whole" in report
    assert "3 episodes checked, 1 broken" in report
    assert "traj_000000 " not in report and "traj_000002" not in report
    assert main([str(tmp_path / "rescued"), "--jobs", "1"]) == 0
    assert len(list_episodes(tmp_path / "rescued" / "pushing-train")) == 1
    assert find_episodes(sound) == [sound]
    assert main([str(tmp_path / "nothing"), "--jobs", "1"]) == 1


def test_doctor_on_several_processes(sound: Path) -> None:
    """The command line as people type it; RLIMIT_AS is set in its workers."""
    command = [sys.executable, "-m", "oes.record.doctor", str(sound), "--jobs", "2"]
    env = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=env, check=False)
    assert done.returncode == 0, done.stderr
    assert "1 episodes checked, 0 broken" in done.stdout
