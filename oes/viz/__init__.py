"""Overlays on camera images, and video files."""
