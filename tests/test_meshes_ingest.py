"""Meshes from elsewhere: every kind of bad file is mended or rejected by name, ShapeNet trees are
read.
"""

import csv
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from oes.config import load
from oes.meshes.build import MeshesConfig, build_catalogue, ingest_folder
from oes.meshes.catalogue import Catalogue, CatalogueError
from oes.meshes.convex import fill
from oes.meshes.draft import MeshRejected
from oes.meshes.generators.procedural import generate
from oes.meshes.ingest import SYNSETS, folder_candidates, shapenet_candidates, slug
from oes.meshes.repair import UPRIGHT_FROM_Y, check_surface, repaired

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def cfg() -> MeshesConfig:
    whole = load(ROOT / "params.smoke.yaml", "meshes", MeshesConfig)
    quick = replace(whole.ingest.convex, threshold=0.3, resolution=400, mcts_iterations=10)
    repair = replace(whole.ingest.repair, max_bytes=2_000_000, simplify_faces=3000)
    return replace(whole, ingest=replace(whole.ingest, convex=quick, repair=repair), tile_px=48)


def _soup(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Unshared vertices, mixed winding, a doubled and a degenerate face: what exporters leave
    behind.
    """
    vertices = mesh.triangles.reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 3)
    faces[::3] = faces[::3, ::-1]
    return trimesh.Trimesh(vertices, np.concatenate([faces, faces[:1], [[0, 0, 1]]]), process=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One good mesh of each format, and one file of each kind of trouble."""
    root = tmp_path_factory.mktemp("own")
    box = trimesh.creation.box((0.3, 0.2, 0.1))
    for suffix in ("obj", "stl", "ply", "off"):
        box.export(root / f"good_{suffix}.{suffix}")
    trimesh.creation.box((0.3, 0.1, 0.2)).export(root / "good_glb.GLB".lower())
    trimesh.creation.box((0.1, 0.1, 0.4)).export(root / "good_tower.stl")
    (root / "block").mkdir()
    box.export(root / "block" / "good.stl")
    (root / "toys").mkdir()
    box.copy().apply_scale(30000.0).export(root / "toys" / "kilometres.obj")
    box.copy().apply_scale(1e-6).export(root / "toys" / "micrometres.obj")
    _soup(box).export(root / "toys" / "soup.obj")
    holed = box.copy()
    holed.update_faces(np.arange(12) != 5)
    holed.export(root / "toys" / "holed.ply")
    trimesh.creation.icosphere(subdivisions=4).export(root / "toys" / "fine.ply")
    tall = trimesh.creation.box((0.3, 0.2, 0.2))
    pair = [tall, tall.copy().apply_translation((0.3, 0.2, 0.0))]
    merged = trimesh.util.concatenate(pair)
    merged.merge_vertices()
    merged.export(root / "toys" / "sharing an edge.obj")
    _write_bad(root, box)
    return root


def _write_bad(root: Path, box: trimesh.Trimesh) -> None:
    (root / "empty.obj").write_bytes(b"")
    (root / "no_faces.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    (root / "nan.obj").write_text(
        "v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n"
    )
    (root / "index.off").write_text(
        "OFF\n4 4 0\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 1 2\n3 0 1 3\n3 0 2 3\n3 1 2 99\n"
    )
    trimesh.creation.box((1, 1, 0)).export(root / "plane.obj")
    trimesh.creation.box((1, 0.05, 0.05)).export(root / "needle.stl")
    (root / "truncated.stl").write_bytes(box.export(file_type="stl")[:300])
    (root / "promises.stl").write_bytes(b"\0" * 80 + struct.pack("<I", 4_000_000_000) + b"\0" * 100)
    (root / "garbage.glb").write_bytes(np.random.default_rng(0).bytes(4096))
    (root / "huge.ply").write_bytes(b"\0" * 2_000_001)
    top = trimesh.creation.cone(0.5, 1.0).apply_transform(np.diag([1.0, -1.0, -1.0, 1.0]))
    top.export(root / "on its tip.stl")
    (root / "notes.txt").write_text("not a mesh")


@pytest.fixture(scope="module")
def ingested(
    folder: Path, cfg: MeshesConfig, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Catalogue, dict[str, str]]:
    out = tmp_path_factory.mktemp("out") / "meshes"
    catalogue = ingest_folder(folder, cfg, out)
    with (out / "rejected.csv").open(newline="") as file:
        return catalogue, {row["source"]: row["reason"] for row in csv.DictReader(file)}


REASONS = {
    "empty.obj": "empty file",
    "no_faces.obj": "no triangles",
    "nan.obj": "not finite",
    "index.off": "vert",
    "plane.obj": "zero volume",
    "needle.stl": "sides 20.0 to 1",
    "truncated.stl": "no triangles: truncated",
    "promises.stl": "no triangles: truncated",
    "garbage.glb": "unreadable",
    "huge.ply": "at most 2000000",
    "on its tip.stl": "tips over",
}


@pytest.mark.parametrize("source", sorted(REASONS))
def test_a_bad_file_is_rejected_with_its_reason(
    source: str, ingested: tuple[Catalogue, dict[str, str]]
) -> None:
    assert REASONS[source] in ingested[1][source]


def test_nothing_else_is_rejected_and_all_others_are_accepted(
    ingested: tuple[Catalogue, dict[str, str]],
) -> None:
    catalogue, rejected = ingested
    assert rejected.keys() == REASONS.keys()
    assert len(catalogue.split("test")) == len(catalogue.meshes) == 13
    assert {mesh.category for mesh in catalogue.meshes.values()} == {"custom", "toys"}


def test_any_unit_any_format_gives_one_canonical_frame(
    ingested: tuple[Catalogue, dict[str, str]], cfg: MeshesConfig
) -> None:
    for mesh in ingested[0].meshes.values():
        assert mesh.extents_m_3[2] <= cfg.ingest.max_height_m + 1e-7
        if mesh.id != "good_tower":
            assert cfg.size.min_m <= mesh.extents_m_3[:2].max() <= cfg.size.max_m
        np.testing.assert_allclose(mesh.visual.bounds.sum(0), 0, atol=1e-7)
    np.testing.assert_allclose(
        ingested[0].meshes["good_tower"].extents_m_3, [0.03, 0.03, 0.12], atol=1e-7
    )
    for name in (
        "good_obj",
        "good_glb",
        "toys_kilometres",
        "toys_micrometres",
        "toys_soup",
        "toys_holed",
    ):
        mesh = ingested[0].meshes[name]
        shape = mesh.extents_m_3 / mesh.extents_m_3.max()
        np.testing.assert_allclose(shape, [1, 2 / 3, 1 / 3], atol=1e-3)
        assert mesh.volume_m3 == pytest.approx(mesh.extents_m_3.prod(), rel=1e-3)
        assert mesh.visual.is_volume


def test_repairs_are_listed_in_the_status(
    ingested: tuple[Catalogue, dict[str, str]], cfg: MeshesConfig
) -> None:
    catalogue = ingested[0]
    path = catalogue.meshes["good_obj"].collision_path.parents[1] / "catalogue.csv"
    with path.open(newline="") as file:
        status = {row["id"]: row["status"] for row in csv.DictReader(file)}
    assert status["good_obj"] == "clean"
    assert all(
        step in status["toys_soup"] for step in ("merged", "degenerate", "duplicate", "rewound")
    )
    assert "filled holes" in status["toys_holed"]
    assert "simplified 5120" in status["toys_fine"]
    assert len(catalogue.meshes["toys_fine"].visual.faces) <= cfg.ingest.repair.simplify_faces
    assert "convex parts" in status["toys_sharing_an_edge"]
    pair = catalogue.meshes["toys_sharing_an_edge"]
    assert pair.volume_m3 == pytest.approx(fill(pair.parts).volume, rel=1e-4)


def test_a_shapenet_tree_is_read_upright_and_replaces_the_generators(
    cfg: MeshesConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for category, synset in SYNSETS.items():
        solid = generate(category, 0, np.random.default_rng(0)).solid.convex_hull
        _plant(solid, tmp_path / "net" / synset / "abc0" / "models" / "model_normalized.obj")
        _plant(solid, tmp_path / "net" / synset / "abc1" / "model.obj")
        _plant(
            trimesh.creation.box((1, 1, 0)),
            tmp_path / "net" / synset / "abc2" / "models" / "model_normalized.obj",
        )
    catalogue = build_catalogue(replace(cfg, shapenet=str(tmp_path / "net")), tmp_path / "meshes")
    assert len(catalogue.meshes) == 11 + 13 + 2 * 4
    found = catalogue.meshes["mug_abc0"]
    assert found.source == "shapenet:03797390/abc0"
    truth = generate("mug", 0, np.random.default_rng(0)).solid.extents
    np.testing.assert_allclose(
        found.extents_m_3 / found.extents_m_3[2], truth / truth[2], rtol=1e-4
    )
    assert (tmp_path / "meshes" / "rejected.csv").read_text().count("zero volume: flat") == 4


def _plant(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write a mesh as ShapeNet has it: y up, centred, unit diagonal."""
    mesh = mesh.copy().apply_transform(np.linalg.inv(UPRIGHT_FROM_Y))
    mesh.apply_translation(-mesh.bounds.mean(0))
    mesh.apply_scale(1 / mesh.scale)
    path.parent.mkdir(parents=True)
    mesh.export(path)


def test_folders_without_meshes_are_named(cfg: MeshesConfig, tmp_path: Path) -> None:
    with pytest.raises(CatalogueError, match="nowhere: no such folder"):
        folder_candidates(tmp_path / "nowhere", cfg.ingest, set())
    with pytest.raises(CatalogueError, match="no file ending in"):
        folder_candidates(tmp_path, cfg.ingest, set())
    with pytest.raises(CatalogueError, match="no ShapeNet models of category 'bed'"):
        shapenet_candidates(tmp_path, "bed")


def test_ids_are_safe_and_unique(cfg: MeshesConfig, tmp_path: Path) -> None:
    for name in ("a b.obj", "a-b.obj", "A_B.stl", "日本.ply"):
        (tmp_path / name).write_text("")
    ids = [candidate.id for candidate in folder_candidates(tmp_path, cfg.ingest, {"a_b"})]
    assert sorted(ids) == ["a_b_2", "a_b_3", "a_b_4", "mesh"]
    assert slug("../../etc/passwd") == "etc_passwd"


def test_one_hopeless_folder_says_why(cfg: MeshesConfig, tmp_path: Path) -> None:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "empty.obj").write_bytes(b"")
    with pytest.raises(CatalogueError, match="none of 1 meshes is usable: 1 x empty file"):
        ingest_folder(tmp_path / "own", cfg, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_file_beyond_its_time_is_rejected(
    cfg: MeshesConfig, folder: Path, tmp_path: Path
) -> None:
    hasty = replace(cfg, ingest=replace(cfg.ingest, limit_s=1e-3))
    with pytest.raises(CatalogueError, match=r"took longer than 0\.001 s"):
        ingest_folder(folder / "toys", hasty, tmp_path / "out")


def test_an_open_mesh_with_too_many_faces_is_clustered(cfg: MeshesConfig) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    ball.update_faces(ball.triangles_center[:, 2] < 0.3)
    check_surface(ball, cfg.ingest.repair)
    repair = replace(cfg.ingest.repair, simplify_faces=2000)
    mended, status = repaired(
        trimesh.Trimesh(ball.vertices * 0.05, ball.faces[::-1][: len(ball.faces) - 7]), repair
    )
    assert len(mended.faces) <= 2000 and "simplified" in status
    np.testing.assert_allclose(mended.extents, [0.1, 0.1, 0.065], atol=0.006)
    with pytest.raises(MeshRejected, match="faces, from 4"):
        check_surface(ball, replace(repair, max_faces=100))
