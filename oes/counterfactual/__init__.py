"""Seeing what dynamics forecasts: object features moved in the 3D map, decoded from any camera
(paper 3.2, A).
"""
