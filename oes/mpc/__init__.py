"""Model predictive control of pushes: candidate plans, their cost, and the search for the best.

May import: geom, config, numpy, scipy and torch. It never reaches the simulator, the renderer or
perception: models and costs arrive as functions. Start reading at ``search.search``; then
``sampler`` (candidates), ``cost`` (goal and collision cost), ``geodesic`` (distances around
obstacles) and ``tracking`` (which detection is which object).
"""
