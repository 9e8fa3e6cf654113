"""Raw rows into tables, figures and metrics.json. Imports neither torch nor pybullet."""
