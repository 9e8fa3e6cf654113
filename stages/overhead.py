"""overhead: images of every state of the pushing episodes from a fixed camera above the table."""

from pathlib import Path

from oes.baselines.clips import write_clips
from oes.baselines.overhead_render import OverheadConfig, make_clips
from oes.cli import run
from oes.meshes.catalogue import load_catalogue
from oes.record.dataset import read_states
from oes.stage import publish, work_dir


def main(cfg: OverheadConfig, split: str, meshes: Path, episodes: Path, out: Path) -> None:
    """Write ``clips.safetensors`` to ``out``."""
    with work_dir(out, (cfg, split, [meshes, episodes])) as work:
        clips = make_clips(read_states(episodes), load_catalogue(meshes), cfg)
        write_clips(clips, cfg.view, work)
        publish(work, out)


if __name__ == "__main__":
    run(main)
