"""episodes: simulated pushing or falling objects seen by 27 cameras; one MCAP file an episode."""

from pathlib import Path

from oes.cli import run
from oes.episodes.capture import capture_split
from oes.episodes.dataset_card import statistics, write_card
from oes.episodes.index import write_index
from oes.record.dataset import read_states
from oes.sim.simulate import EpisodesConfig
from oes.stage import publish, work_dir


def main(cfg: EpisodesConfig, task: str, split: str, meshes: Path, out: Path) -> None:
    """Write traj_NNNNNN/ (rosbag2), card.json, card.md, card.png, index.html and sheets/."""
    with work_dir(out, (cfg, [meshes], task, split)) as work:
        failures = capture_split(meshes, cfg, task, split, work)
        episodes = read_states(work)
        write_card(statistics(episodes, failures, cfg), work)
        write_index(work, episodes, cfg.sheets.camera, cfg.sheets.count)
        publish(work, out)


if __name__ == "__main__":
    run(main)
