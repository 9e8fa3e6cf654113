"""The generated meshes: MIT Push outlines against the originals, sound solids, parts that fill
them.
"""

from pathlib import Path

import numpy as np
import pytest
import shapely
import trimesh

from oes.meshes.convex import fill, solid_mass
from oes.meshes.draft import resting
from oes.meshes.generators.mit_push import OUTLINES_MM, plate
from oes.meshes.generators.procedural import GENERATORS, generate
from oes.meshes.generators.shapes import Shape, block, convex_hull
from tests.convex import is_inside

ORIGINALS = Path(__file__).resolve().parents[2] / "shared" / "meshes" / "mit_push"
NUM_STYLES = 5


@pytest.fixture(scope="module")
def shapes() -> dict[str, Shape]:
    plates = {name: plate(name, 0.08, 0.04) for name in OUTLINES_MM}
    others = {
        f"{category}_{style}": generate(category, style, np.random.default_rng(style))
        for category in GENERATORS
        for style in range(NUM_STYLES)
    }
    return plates | others


@pytest.mark.skipif(
    not ORIGINALS.is_dir(), reason="the original meshes are not beside the repository"
)
@pytest.mark.parametrize("name", sorted(OUTLINES_MM))
def test_mit_push_outlines_match_the_originals_at_true_scale(name: str) -> None:
    original = trimesh.load_mesh(ORIGINALS / f"{name}.obj", skip_materials=True)
    top = original.triangles[original.face_normals[:, 1] > 0.99] * 1e3
    theirs = shapely.union_all([shapely.Polygon(triangle[:, [0, 2]] * [1, -1]) for triangle in top])
    ours = shapely.Polygon(OUTLINES_MM[name])
    assert ours.intersection(theirs).area / ours.union(theirs).area >= 0.97


def test_plates_have_the_size_asked_for() -> None:
    for name in OUTLINES_MM:
        extents = plate(name, 0.08, 0.04).solid.extents
        assert extents[:2].max() == pytest.approx(0.08) and extents[2] == pytest.approx(0.04)


def test_every_generated_mesh_is_one_watertight_volume(shapes: dict[str, Shape]) -> None:
    bad = {
        name
        for name, shape in shapes.items()
        if not (shape.solid.is_volume and shape.solid.body_count == 1)
    }
    assert not bad


def test_parts_are_convex_and_fill_their_mesh(shapes: dict[str, Shape]) -> None:
    ratios = {name: fill(shape.parts).volume / shape.solid.volume for name, shape in shapes.items()}
    print({name: round(ratio, 3) for name, ratio in ratios.items()})
    assert all(part.is_convex for shape in shapes.values() for part in shape.parts)
    for name, ratio in ratios.items():
        thin_walled = name.startswith(("mug", "bowl"))
        assert 0.998 < ratio < (1.5 if thin_walled else 1.04), (name, ratio)


def test_parts_cover_the_surface_and_leave_cavities_open(shapes: dict[str, Shape]) -> None:
    for category in ("mug", "bowl"):
        for style in range(NUM_STYLES):
            shape = shapes[f"{category}_{style}"]
            points = shape.solid.sample(400, seed=0)
            points = 0.999 * points + 0.001 * shape.solid.triangles_center.mean(0)
            assert is_inside(shape.parts, points).mean() > 0.9
            mouth = np.array([[0.0, 0.0, share * shape.solid.bounds[1, 2]] for share in (0.5, 0.8)])
            assert not is_inside(shape.parts, mouth).any()


def test_styles_of_a_category_differ(shapes: dict[str, Shape]) -> None:
    for category in GENERATORS:
        solids = [shapes[f"{category}_{style}"].solid for style in range(NUM_STYLES)]
        fullness = {round(float(solid.volume / solid.extents.prod()), 3) for solid in solids}
        assert len(fullness) == NUM_STYLES


def test_generators_depend_on_their_seed_only() -> None:
    first, again, other = (
        generate("camera", 0, np.random.default_rng(seed)).solid for seed in (3, 3, 4)
    )
    assert (
        first.vertices.tobytes() == again.vertices.tobytes()
        and first.faces.tobytes() == again.faces.tobytes()
    )
    assert first.vertices.tobytes() != other.vertices.tobytes()


def test_mass_of_a_box_is_the_textbook_one() -> None:
    mass = solid_mass(
        convex_hull([(x, y, z) for x in (0, 2) for y in (0, 3) for z in (0, 4)]).solid
    )
    assert mass.volume_m3 == pytest.approx(24)
    np.testing.assert_allclose(mass.com_obj_3, [1, 1.5, 2])
    np.testing.assert_allclose(
        mass.inertia_obj_33, np.diag([9 + 16, 4 + 16, 4 + 9]) * 24 / 12, atol=1e-9
    )


@pytest.mark.parametrize(("tilt_deg", "expected_deg"), [(0.0, 0.0), (10.0, 10.0), (-35.0, 35.0)])
def test_a_tilted_box_falls_back_onto_its_face(tilt_deg: float, expected_deg: float) -> None:
    box = block((2, 3, 1.5), (0, 0, 0), 0.01).solid
    box.apply_transform(trimesh.transformations.rotation_matrix(np.radians(tilt_deg), [1, 0, 0]))
    rotation_44, found_deg = resting(box, box.center_mass)
    assert found_deg == pytest.approx(expected_deg, abs=0.01)
    assert box.apply_transform(rotation_44).extents[2] == pytest.approx(1.5, abs=1e-6)
