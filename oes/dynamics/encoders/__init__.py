"""Encoders of object shapes for the graph network: crop slabs, height maps, surface points.

Each turns the first frame's shapes and the current ``ObjectState`` into ``GraphFeatures``. May
import ``dynamics.graph`` and ``dynamics.shapes``. Start with ``crop_encoder``.
"""
