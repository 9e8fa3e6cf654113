"""Bullet: the world, the arm, random scenes of both tasks, episodes and their re-runs. Nothing else
uses pybullet.
"""
