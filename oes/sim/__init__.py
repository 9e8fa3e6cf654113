"""Bullet: the world, the arm, random pushing scenes, episodes and their re-runs. The only package that uses pybullet."""
