"""The simulator, and the only user of pybullet: world, arm, random scenes, episodes and replays.

May import: config, episode, geom and meshes. Start with ``simulate`` (an episode), then
``attempt``, ``scene`` and ``drop`` (its random scenes) and ``world`` (Bullet).
"""
