"""Closed-loop trials: tasks, the loop of seeing, planning and pushing, many trials of one model,
and their films.
"""
