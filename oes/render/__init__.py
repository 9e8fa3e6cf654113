"""Renderer of triangle meshes: RGB, z-depth and segmentation of a state from every camera.

Reading order: ``scene`` (what is drawn), ``renderer`` (the entry point), ``raster`` (visibility),
``normals``, ``texture`` and ``shade`` (colour). It may import ``geom``, ``jit`` and ``episode``;
``meshes`` and ``sim`` for types only.
"""
