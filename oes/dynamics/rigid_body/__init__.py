"""Rigid bodies on a table in contact: the prior of the model ``contact``."""
