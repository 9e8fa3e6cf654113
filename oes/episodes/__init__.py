"""Episodes: capture of a split in simulation, its dataset card and its contact sheets.

Reading order: ``capture`` (simulate, render, record), ``motion`` and ``dataset_card`` (statistics
of a split), ``sheet`` and ``index`` (HTML). It may import ``sim``, ``render`` and ``record``.
"""
