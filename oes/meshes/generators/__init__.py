"""Generators of meshes with exact convex parts."""
