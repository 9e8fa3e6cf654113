"""Bullet: the world, the arm, random pushing scenes, episodes and their re-runs. Nothing else uses pybullet."""
