"""Errors, image metrics and statistics. Numpy and scipy only, no files."""
