"""Raw rows of all stages as tables, figures, pages and metrics.json.

``inputs`` reads the rows, ``aggregates`` computes one tidy frame of every number, and the other
modules render it. Imports neither a model nor the simulator. Start with ``build``.
"""
