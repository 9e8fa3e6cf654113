"""Episodes: capture of a split in simulation, its dataset card and its contact sheets.

Reading order: ``capture`` (simulate, render, record), ``dataset_card`` (statistics of a split),
``sheet`` (HTML). It may import ``sim``, ``render``, ``record`` and everything below them.
"""
