"""meshes: the catalogue of objects to push and to drop, with convex parts, mass and a split."""

from pathlib import Path

from oes.cli import run
from oes.meshes.build import MeshesConfig, build_catalogue
from oes.render.contact_sheet import write_contact_sheet
from oes.stage import publish, work_dir


def main(cfg: MeshesConfig, out: Path) -> None:
    """Write catalogue.csv, rejected.csv, contact_sheet.png and a folder per mesh."""
    with work_dir(out, (cfg,)) as work:
        catalogue = build_catalogue(cfg, work / "catalogue")
        write_contact_sheet(catalogue, cfg.tile_px, work / "catalogue" / "contact_sheet.png")
        publish(work / "catalogue", out)


if __name__ == "__main__":
    run(main)
