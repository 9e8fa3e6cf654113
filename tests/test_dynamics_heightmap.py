"""Height maps of shapes whose heights are known."""

import pytest
import torch
from torch import Tensor

from oes.dynamics.encoders.crop_encoder import CropConfig
from oes.dynamics.encoders.heightmap_encoder import HeightmapEncoder
from oes.dynamics.graph import TipMotion
from oes.dynamics.unroll import initial_state

CROP = CropConfig(
    encoder="heightmap",
    num_channels=1,
    num_slabs=1,
    channels=(4, 4, 4),
    width=8,
    cell_m=0.01,
    path_cell_m=0.01,
)
QUARTER_TURN = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y goes to z


def make_encoder() -> HeightmapEncoder:
    torch.manual_seed(0)
    return HeightmapEncoder(CROP, 16, 0.01, unit_m=0.05)


def box(half_x: int, half_y: int, half_z: int) -> Tensor:
    """A mask of 16 cm with a box of given half sides (cm)."""
    mask = torch.zeros(16, 16, 16)
    mask[8 - half_x : 8 + half_x, 8 - half_y : 8 + half_y, 8 - half_z : 8 + half_z] = 1
    return mask


@pytest.mark.parametrize(
    ("rotation", "half_y", "half_z"), [(torch.eye(3), 2, 4), (QUARTER_TURN, 4, 2)]
)
def test_underside_and_top_of_a_box_are_at_half_its_height_in_any_orientation(
    rotation: Tensor, half_y: int, half_z: int
) -> None:
    coverage, underside, top = make_encoder().maps(box(3, 2, 4)[None], rotation[None])[0]
    expected = torch.zeros(16, 16)
    expected[5:11, 8 - half_y : 8 + half_y] = 1
    torch.testing.assert_close(coverage, expected, atol=1e-4, rtol=0)
    middle = half_z / 100 - 0.005  # the middle of the outermost voxels
    torch.testing.assert_close(underside, -middle * expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(top, middle * expected, atol=1e-5, rtol=0)


def test_the_gap_between_two_blocks_is_measured_and_located() -> None:
    """A small block 5 cm above a wide one's top, aside: the gap is below the one and above the
    other.
    """
    encoder, ends = make_encoder(), (torch.tensor([0, 1]), torch.tensor([1, 0]))
    center = torch.tensor([[0.03, 0.0, 0.11], [0.0, 0.0, 0.02]])
    maps = encoder.maps(torch.stack([box(2, 2, 2), box(4, 4, 2)]), torch.eye(3).expand(2, 3, 3))
    windows = encoder.edge_windows(maps, center, ends)
    assert float(windows[0, 6, 9, 8]) * 0.05 == pytest.approx(
        0.06, abs=1e-4
    )  # 5 cm between faces, 6 between voxels
    assert float(windows[0, 6, 3, 8]) == 0  # the wide one alone
    small, wide = encoder.object_gaps(windows, center, ends)
    unit = torch.tensor([1, 0.05, 0.05, 0.05]).repeat(2)
    (below_small, flat), (above_small, _) = ((half[:8] * unit, half[8:]) for half in small.chunk(2))
    above_wide = wide[12:20] * unit
    assert not flat.any()
    assert below_small[:2].tolist() == pytest.approx([1, 0.06], abs=1e-4)
    assert above_small[1] < -0.1, "the wide one is below, not above"
    torch.testing.assert_close(
        above_wide, torch.cat([below_small[4:], below_small[:4]]), atol=1e-6, rtol=0
    )
    from_small, from_wide = below_small[2:4], below_small[6:8]
    torch.testing.assert_close(
        from_wide - from_small, center[0, :2] - center[1, :2], atol=1e-6, rtol=0
    )
    assert -0.02 < float(from_small[0]) < 0.005, (
        "they overlap where x of the small one is in [-2, 1] cm"
    )


def test_the_slope_of_a_roof_is_measured_under_a_falling_block() -> None:
    encoder, ends = make_encoder(), (torch.tensor([0]), torch.tensor([1]))
    roof = torch.stack(
        [(torch.arange(16) < 14 - abs(x - 7)).float().expand(16, 16) for x in range(16)]
    )
    center = torch.tensor([[0.04, 0.0, 0.3], [0.0, 0.0, 0.08]])
    maps = encoder.maps(torch.stack([box(2, 2, 2), roof]), torch.eye(3).expand(2, 3, 3))
    found = encoder.object_gaps(encoder.edge_windows(maps, center, ends), center, ends)[0]
    under_block, on_roof = found[8:10], found[10:12]
    torch.testing.assert_close(under_block, torch.zeros(2), atol=1e-4, rtol=0)
    torch.testing.assert_close(on_roof, torch.tensor([-1.0, 0.0]), atol=0.05, rtol=0)


def test_the_lowest_point_is_located_above_the_table() -> None:
    encoder = make_encoder()
    mask = box(2, 2, 3)
    mask[:8, :, :6] = 0  # its lowest part is at +x
    center = torch.tensor([[0.1, -0.1, 0.07]])
    own = encoder.node_windows(encoder.maps(mask[None], torch.eye(3)[None]), center)
    assert float(own[0, 1, 8, 8]) * 0.05 == pytest.approx(0.07 - 0.025, abs=1e-5)
    is_there, height, x, y = encoder.table_gaps(own)[0].tolist()
    assert (is_there, height * 0.05) == (1, pytest.approx(0.045, abs=1e-3))
    assert x * 0.05 == pytest.approx(0.01, abs=1e-3) and y == pytest.approx(0, abs=1e-4)


@torch.no_grad()
def test_padding_and_lone_objects_have_no_features_of_pairs() -> None:
    encoder, mask = make_encoder(), torch.stack([box(2, 2, 3), box(3, 2, 2)])[None]
    center = torch.tensor([[[0.0, 0.0, 0.1], [0.05, 0.0, 0.02]]])
    tip = TipMotion(torch.zeros(1, 3), torch.zeros(1, 3))
    alone = encoder(mask[:, :1], initial_state(center[:, :1], torch.tensor([[True]])), tip)
    padded = encoder(mask, initial_state(center, torch.tensor([[True, False]])), tip)
    torch.testing.assert_close(padded.node_BNC[:, 0], alone.node_BNC[:, 0])
    assert (
        not padded.node_BNC[:, 1].any() and not padded.edge_BNNC.any() and not alone.edge_BNNC.any()
    )
