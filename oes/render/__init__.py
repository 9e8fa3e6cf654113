"""Images of a state: every view's RGB, z-depth and segmentation, from triangle meshes and their
poses.
"""
