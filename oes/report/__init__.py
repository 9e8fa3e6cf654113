"""Raw rows into tables, figures and metrics.json. Needs neither a model nor the simulator."""
