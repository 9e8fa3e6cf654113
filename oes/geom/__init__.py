"""Geometry of the conventions in ``oes``: rigid motions, cameras, boxes and voxel grids."""
