"""Perception: posed RGB-D views to a 3D feature map, the objects in it, and images of it from other
cameras.
"""
