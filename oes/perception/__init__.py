"""Perception: posed RGB-D views to a 3D feature map, its objects, and images from other cameras.

May import ``geom``, ``meshes``, ``metrics``, ``record`` and ``training``, never ``sim`` or models
that use its output. Start reading at ``network`` (all trained parts), then ``perceiver`` (inference
with one network); ``train`` and ``surface_training`` make the weights, ``objects_file`` stores the
perceived objects.
"""
