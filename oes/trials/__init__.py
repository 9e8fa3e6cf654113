"""Closed-loop trials of model predictive control in the simulator (C.3).

May import anything but apps. Start with ``loop`` (one trial), then ``planner`` (perception, world
model and search), ``world_models`` and ``runner`` (all trials of a scenario).
"""
