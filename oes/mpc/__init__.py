"""Model predictive control: what to push, where to start, how far. Knows models and costs as
functions only.
"""
