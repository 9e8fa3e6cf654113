"""episodes: objects pushed by the arm in the simulator, seen by 27 cameras at every state; one MCAP
a trajectory.
"""

from pathlib import Path

from oes.cli import run
from oes.episodes.capture import capture_split
from oes.episodes.dataset_card import statistics, write_card
from oes.record.dataset import read_states
from oes.record.index import write_index
from oes.sim.simulate import EpisodesConfig
from oes.stage import publish, work_dir


def main(cfg: EpisodesConfig, task: str, split: str, meshes: Path, out: Path) -> None:
    """Write traj_NNNNNN/ (a rosbag2 folder each), the card (card.json, card.md, card.png) and
    index.html.
    """
    with work_dir(out, (cfg, [meshes], task, split)) as work:
        failures = capture_split(meshes, cfg, task, split, work)
        write_card(statistics(read_states(work), failures, cfg), work)
        write_index(work, cfg.sheets.camera, cfg.sheets.count)
        publish(work, out)


if __name__ == "__main__":
    run(main)
