"""Overlays on camera images (``overlay``) and video files (``video``).

It may import ``geom``, ``episode`` and libraries.
"""
