"""Metrics without file access: errors of objects and boxes, image quality, statistics.

May import: episode and geom. ``errors`` and ``statistics`` need numpy and scipy only.
"""
