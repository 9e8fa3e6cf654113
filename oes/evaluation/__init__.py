"""Evaluation of forecasts on test episodes: errors of every model against the recorded motion.

May import everything up to dynamics, and sim for the simulator's own forecast. Start reading at
``evaluate_forecasts.error_rows``; ``forecasters`` has the models' and the simulator's forecasts.
"""
