"""Geometry of the conventions in ``oes``: rigid motions, cameras, boxes, voxel grids and profiles.

May import: config and episode. numpy arrays serve recorded data, torch tensors the networks.
"""
