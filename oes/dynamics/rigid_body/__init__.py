"""Rigid bodies on a table, pushed by a rod and by each other: the prior of the model ``contact``.

The compiled solver follows Bullet's scheme, the simulator of the data set: contact detection adds
one deepest point per pair and substep to a persistent manifold of at most four points; sequential
impulses (projected Gauss-Seidel) enforce non-penetration and the friction cone; semi-implicit Euler
integrates. From the data set it takes only nominal constants (``bodies.ContactPhysics``): substep,
friction coefficients, rod geometry and contact margin. Masses, shapes and poses come from
perception.

Differences from Bullet: shapes are radial profiles instead of meshes, two bodies touch at two
points that are detected anew in every substep, impulses are not warm-started, and an action leaves
all bodies upright.

May import: config, episode, geom, jit and objects. Start reading at ``push.simulate_push``, then
``substeps``, ``contact_detection``, ``contact_manifold``, ``constraints`` and ``solver``.
"""
