"""Forecasts of every model on test episodes, and their errors against the recorded motion."""
