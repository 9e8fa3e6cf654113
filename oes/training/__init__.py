"""Training that all networks share. Imports config and progress only; start reading in ``loop``."""
