"""Voxel grids: where voxels lie, and that resampling neither shifts nor scales."""

import pytest
import torch

from oes.geom.voxels import Grid, centers, crop, cube, fold_order, sample, unfold, voxelize

GRID = Grid(min_m=(-0.1, -0.08, 0.0), shape=(20, 16, 12), voxel_m=0.01)
VOLUME = torch.randn(2, 3, *GRID.shape, generator=torch.Generator().manual_seed(0))


def test_the_first_and_last_voxels_lie_half_a_voxel_inside_the_bounds() -> None:
    points = centers(GRID)
    torch.testing.assert_close(points[0, 0, 0], torch.tensor([-0.095, -0.075, 0.005]))
    torch.testing.assert_close(points[-1, -1, -1], torch.tensor([0.095, 0.075, 0.115]))


def test_sampling_at_voxel_centres_is_the_identity_and_outside_is_zero() -> None:
    points = centers(GRID).reshape(1, -1, 3).expand(2, -1, -1)
    torch.testing.assert_close(
        sample(VOLUME, GRID, points), VOLUME.flatten(2).transpose(1, 2), atol=1e-5, rtol=0
    )
    assert sample(VOLUME, GRID, torch.full((2, 1, 3), 5.0)).abs().max() == 0


def test_a_crop_at_a_voxel_corner_is_a_slice_and_a_voxel_further_the_next_slice() -> None:
    window = cube(4, 0.01)
    corner = torch.tensor([-0.1 + 0.08, -0.08 + 0.06, 0.05])
    found = crop(
        VOLUME,
        GRID,
        torch.stack([corner, corner + torch.tensor([0.01, 0, 0])]).expand(2, 2, 3),
        window,
    )
    torch.testing.assert_close(found[:, 0], VOLUME[:, :, 6:10, 4:8, 3:7], atol=1e-5, rtol=0)
    torch.testing.assert_close(found[:, 1], VOLUME[:, :, 7:11, 4:8, 3:7], atol=1e-5, rtol=0)


def test_a_linear_field_is_sampled_exactly_between_voxels() -> None:
    field = centers(GRID).movedim(-1, 0)[None]
    points = torch.tensor([[[0.0123, -0.0341, 0.0456], [-0.05, 0.02, 0.1]]])
    torch.testing.assert_close(sample(field, GRID, points), points, atol=1e-5, rtol=0)


def test_voxelize_fills_the_voxels_of_the_points_and_drops_nan_and_outsiders() -> None:
    points = torch.tensor(
        [[[-0.0999, -0.0799, 0.0001], [0.0999, 0.0799, 0.1199], [0.2, 0, 0], [torch.nan] * 3]]
    )
    filled = voxelize(points, GRID)
    assert filled.nonzero().tolist() == [[0, 0, 0, 0], [0, 19, 15, 11]]
    assert voxelize(torch.full((1, 5, 3), torch.nan), GRID).sum() == 0


def test_unfold_undoes_fold_order() -> None:
    field = centers(GRID)
    folded = fold_order(field).flatten(3).movedim(-1, 0)[None]
    torch.testing.assert_close(unfold(folded)[0].movedim(0, -1), field)
    torch.testing.assert_close(fold_order(field).mean(dim=3), centers(GRID.halved()))


def test_a_grid_with_an_odd_axis_cannot_be_halved() -> None:
    with pytest.raises(ValueError, match="even"):
        Grid(min_m=(0.0, 0.0, 0.0), shape=(4, 5, 4), voxel_m=0.01).halved()
