"""The catalogue as others see it: 31 meshes to push, 13 blocks to drop, a fixed split, a folder
that loads back.
"""

import csv
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from oes.config import ParamsError, from_json, load, to_json
from oes.meshes.build import MeshesConfig, build_catalogue
from oes.meshes.catalogue import BLOCK, Catalogue, CatalogueError, assign_splits, load_catalogue
from oes.meshes.generators.blocks import BLOCKS
from oes.render.contact_sheet import write_contact_sheet
from tests.convex import is_inside

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def cfg() -> MeshesConfig:
    return replace(load(ROOT / "params.yaml", "meshes", MeshesConfig), tile_px=40)


@pytest.fixture(scope="module")
def folder(cfg: MeshesConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("catalogue") / "meshes"
    build_catalogue(cfg, out)
    return out


@pytest.fixture(scope="module")
def catalogue(folder: Path) -> Catalogue:
    return load_catalogue(folder)


def test_the_31_meshes_to_push_are_split_24_to_7_within_every_category(
    catalogue: Catalogue,
) -> None:
    tally = {
        category: tuple(
            sum(m.category == category for m in catalogue.split(split))
            for split in ("train", "test")
        )
        for category in ("mit_push", "camera", "mug", "bowl", "bed")
    }
    assert tally == {
        "mit_push": (8, 3),
        "camera": (4, 1),
        "mug": (4, 1),
        "bowl": (4, 1),
        "bed": (4, 1),
    }
    held_out = sorted(
        mesh.id[:-1] for mesh in catalogue.split("test") if mesh.category == "mit_push"
    )
    assert held_out == ["mit_ellip", "mit_rect", "mit_tri"]


def test_the_13_blocks_fall_and_one_of_each_family_is_held_out(catalogue: Catalogue) -> None:
    train, test = (catalogue.split(split, "falling") for split in ("train", "test"))
    assert len(train) == 9 and {mesh.category for mesh in train + test} == {BLOCK}
    families = {f"block_{name}": family for family, blocks in BLOCKS.items() for name in blocks}
    assert {mesh.id for mesh in train + test} == families.keys()
    assert sorted(families[mesh.id] for mesh in test) == sorted(BLOCKS)
    pushed = {mesh.id for split in ("train", "test") for mesh in catalogue.split(split, "pushing")}
    assert pushed == catalogue.meshes.keys() - families.keys()


def test_blocks_stand_as_the_originals_at_one_scale(
    catalogue: Catalogue, cfg: MeshesConfig
) -> None:
    for name, shape in (pair for blocks in BLOCKS.values() for pair in blocks.items()):
        mesh, unit_m = catalogue.meshes[f"block_{name}"], cfg.size.block_unit_m
        np.testing.assert_allclose(mesh.extents_m_3, shape.solid.extents * unit_m, atol=1e-7)
        com_m_3 = (shape.solid.center_mass - shape.solid.bounds.mean(0)) * unit_m
        np.testing.assert_allclose(mesh.com_obj_3, com_m_3, atol=1e-7)


def test_the_split_of_a_mesh_does_not_depend_on_other_strata() -> None:
    cups = [(f"mug_{i}", "mug") for i in range(5)]
    alone = assign_splits(cups, 0.2, 0)
    among = assign_splits([("bed_0", "bed"), *cups[::-1], ("bed_1", "bed")], 0.2, 0)
    assert alone.items() <= among.items() and list(alone.values()).count("test") == 1
    assert assign_splits([("only", "toy")], 0.2, 0) == {"only": "train"}
    assert any(assign_splits(cups, 0.2, seed) != alone for seed in range(1, 9))


def test_meshes_are_canonical_and_of_the_size_asked_for(
    catalogue: Catalogue, cfg: MeshesConfig
) -> None:
    longest_m = [
        mesh.extents_m_3[:2].max() for mesh in catalogue.meshes.values() if mesh.category != BLOCK
    ]
    assert cfg.size.min_m <= min(longest_m) and max(longest_m) <= cfg.size.max_m + 1e-7
    assert 0.07 < np.mean(longest_m) < 0.09
    for mesh in catalogue.meshes.values():
        np.testing.assert_allclose(mesh.visual.bounds.sum(0), 0, atol=1e-7)
        np.testing.assert_allclose(mesh.visual.extents, mesh.extents_m_3, atol=1e-7)
    heights_m = [
        mesh.extents_m_3[2] for mesh in catalogue.meshes.values() if mesh.category == "mit_push"
    ]
    assert cfg.size.plate_min_m <= min(heights_m) and max(heights_m) <= cfg.size.plate_max_m


def test_written_meshes_stay_sound(catalogue: Catalogue, cfg: MeshesConfig) -> None:
    for mesh in catalogue.meshes.values():
        assert mesh.visual.is_volume and mesh.visual.body_count == 1, mesh.id
        assert len(mesh.parts) <= 64
        assert mesh.volume_m3 == pytest.approx(mesh.visual.volume, rel=1e-5)
        assert sum(part.volume for part in mesh.parts) >= 0.99 * mesh.volume_m3
        principal = np.sort(np.linalg.eigvalsh(mesh.inertia_obj_33))
        assert principal[0] > 0 and principal[2] <= principal[0] + principal[1]


def test_points_inside_the_mesh_are_inside_its_parts(catalogue: Catalogue) -> None:
    mesh = catalogue.meshes["bed_2"]
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (20000, 3)) * mesh.extents_m_3
    share = is_inside(mesh.parts, points).mean()
    assert share * mesh.extents_m_3.prod() == pytest.approx(mesh.volume_m3, rel=0.04)


def test_the_same_params_give_the_same_bytes(
    folder: Path, cfg: MeshesConfig, tmp_path: Path
) -> None:
    small = replace(cfg, per_category=1)
    build_catalogue(small, tmp_path / "one")
    build_catalogue(small, tmp_path / "two")
    one, two = _contents(tmp_path / "one"), _contents(tmp_path / "two")
    assert one == two and len(one) == (15 + 13) * 3 + 2
    changed = {name for name, content in one.items() if (folder / name).read_bytes() != content}
    assert changed == {"catalogue.csv"}


def _contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_the_table_holds_every_mesh(folder: Path, catalogue: Catalogue) -> None:
    with (folder / "catalogue.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["id"] for row in rows] == list(catalogue.meshes)
    assert float(rows[0]["x_mm"]) == pytest.approx(
        catalogue.meshes["mit_rect1"].extents_m_3[0] * 1e3, abs=0.06
    )
    assert (folder / "rejected.csv").read_text() == "source,category,reason\n"


def test_the_contact_sheet_shows_every_mesh_and_is_deterministic(
    catalogue: Catalogue, tmp_path: Path
) -> None:
    paths = [tmp_path / "one.png", tmp_path / "two.png"]
    for path in paths:
        write_contact_sheet(catalogue, 40, path)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    picture = cv2.imread(str(paths[0]))
    assert picture.shape[1] > 8 * 40 and picture.std() > 10


def test_a_collision_file_has_one_group_a_part(catalogue: Catalogue) -> None:
    mesh = catalogue.meshes["mug_1"]
    assert mesh.collision_path.read_text().count("\no ") + 1 == len(mesh.parts) > 10


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        ("catalogue.csv", "not a catalogue of meshes"),
        ("bed_1/mesh.json", "mesh.json"),
        ("bed_1/visual.obj", "visual.obj: no meshes"),
        ("mug_1/collision.obj", "collision.obj: no meshes"),
    ],
)
def test_a_spoilt_catalogue_is_refused_by_name(
    spoil: str, message: str, cfg: MeshesConfig, folder: Path
) -> None:
    path = folder / spoil
    content = path.read_bytes()
    try:
        path.write_bytes(b"\xff" if spoil.endswith("csv") else b"{}")
        with pytest.raises(CatalogueError, match=message):
            load_catalogue(folder)
    finally:
        path.write_bytes(content)


def test_a_folder_that_is_no_catalogue_and_an_empty_split_are_refused(
    tmp_path: Path, catalogue: Catalogue
) -> None:
    with pytest.raises(CatalogueError, match="not a catalogue"):
        load_catalogue(tmp_path)
    (tmp_path / "catalogue.csv").write_text("id,split\n../../etc,train\n")
    with pytest.raises(CatalogueError, match="not a plain name"):
        load_catalogue(tmp_path)
    with pytest.raises(CatalogueError, match="no mesh for pushing in split 'validation'"):
        catalogue.split("validation")
    with pytest.raises(CatalogueError, match=r"no mesh for falling .* there are \{\}"):
        Catalogue({"mug_1": catalogue.meshes["mug_1"]}).split("train", "falling")


def test_ill_params_are_refused(cfg: MeshesConfig) -> None:
    with pytest.raises(ParamsError, match="up is 'y' or 'z'"):
        from_json(to_json(cfg).replace('"up":"z"', '"up":"x"'), MeshesConfig)
