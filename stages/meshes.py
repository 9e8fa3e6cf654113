"""meshes: the catalogue of objects to push and to drop: generated or ingested, scaled, decomposed,
split in two.
"""

from pathlib import Path

from oes.cli import run
from oes.meshes.build import MeshesConfig, build_catalogue


def main(cfg: MeshesConfig, out: Path) -> None:
    """Write catalogue.csv, rejected.csv, contact_sheet.png and one folder a mesh."""
    build_catalogue(cfg, out)


if __name__ == "__main__":
    run(main)
