"""Generators of meshes with exact convex parts. Start with ``shapes``."""
