"""Object meshes: generated or ingested, each with convex collision parts, mass properties and a
fixed split.
"""
