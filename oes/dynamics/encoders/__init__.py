"""Encoders of an object at the moment of contact: crop slabs, height maps, surface points."""
