"""Object meshes, generated or ingested, with convex collision parts, mass properties and a split.

May import: config, csv_io, episode, progress and stage. Start with ``catalogue`` (what is on disk),
then ``build`` (the two ways to make one) and ``ingest`` (foreign files).
"""
