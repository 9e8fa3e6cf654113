"""Height maps of shapes whose heights are known."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from oes.dynamics.graph import ObjectState
from oes.dynamics.relief import ReliefSight
from oes.dynamics.slabs import Crop
from oes.dynamics.unroll import at_rest

CROP = Crop(
    sight="relief", read=1, slabs=1, channels=(4, 4, 4), width=8, cell_m=0.01, path_cell_m=0.01
)  # fmt: skip
QUARTER = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # y goes to z


def sight() -> ReliefSight:
    torch.manual_seed(0)
    return ReliefSight(CROP, 16, 0.01, unit_m=0.05)


def box(half_x: int, half_y: int, half_z: int) -> Tensor:
    """A mask of a box, 16 cm wide, by half its sides in cm."""
    mask = torch.zeros(16, 16, 16)
    mask[8 - half_x : 8 + half_x, 8 - half_y : 8 + half_y, 8 - half_z : 8 + half_z] = 1
    return mask


def state(*centers: tuple[float, float, float], turned: Tensor | None = None) -> ObjectState:
    found = at_rest(torch.tensor([centers]), torch.ones(1, len(centers), dtype=torch.bool))
    return found if turned is None else replace(found, turned_BN33=turned.expand(1, len(centers), 3, 3))


@pytest.mark.parametrize(("turned", "half_y", "half_z"), [(torch.eye(3), 2, 4), (QUARTER, 4, 2)])
def test_a_box_has_its_underside_and_top_at_half_its_height_however_it_is_turned(
    turned: Tensor, half_y: int, half_z: int
) -> None:
    covered, under, top = (x[0, 0] for x in sight().maps(box(3, 2, 4)[None, None], turned[None, None]))
    expected = torch.zeros(16, 16)
    expected[5:11, 8 - half_y : 8 + half_y] = 1
    torch.testing.assert_close(covered, expected, atol=1e-4, rtol=0)
    middle = half_z / 100 - 0.005  # the middle of the outermost voxels
    torch.testing.assert_close(under, -middle * expected, atol=1e-5, rtol=0)
    torch.testing.assert_close(top, middle * expected, atol=1e-5, rtol=0)


def test_the_gap_between_two_blocks_is_seen_where_they_overlap_from_above() -> None:
    """A small block 5 cm above a wide one's top: seen by the small one as the gap below, by the wide one as above."""
    masks = torch.stack([box(2, 2, 2), box(4, 4, 2)])[None]
    reader = sight()
    here = state((0.0, 0.0, 0.11), (0.0, 0.0, 0.02))
    pair = reader._pairs(reader.maps(masks, here.turned_BN33), here.center_BN3)[0]
    small_receives, wide_receives = pair * 0.05
    gap = small_receives[6, 7, 7]  # channel 6: the receiver's underside over the sender's top
    assert float(gap) == pytest.approx(0.06, abs=1e-4)  # 5 cm between faces, 6 between the middles of voxels
    assert float(wide_receives[7, 7, 7]) == pytest.approx(0.06, abs=1e-4)
    assert float(small_receives[6, 4, 4]) == 0  # the wide one alone


def test_the_underside_is_told_from_the_table() -> None:
    reader = sight()
    here = state((0.1, -0.1, 0.07))
    own = reader._own(reader.maps(box(2, 2, 3)[None, None], here.turned_BN33), here.center_BN3)[0, 0]
    assert float(own[1, 7, 7]) * 0.05 == pytest.approx(0.07 - 0.025, abs=1e-5)
