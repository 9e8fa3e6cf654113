"""3D-OES: an object-factorised 3D environment simulator learned from RGB-D.

The conventions of the whole code base, defined here and nowhere else.

Frames
    world   z up, table top at z = 0, origin at the table's centre, x away from the robot's base.
    cam     OpenCV: x right, y down, z forward (depth is z, not ray length).
    obj     a mesh's canonical frame, origin at the centre of its bounding box, z up at rest.
    grid    voxel index (x, y, z); voxel i covers [min + i*voxel, min + (i+1)*voxel).
    pix     u right, v down; the centre of the first pixel is (0.5, 0.5).

Transforms are named ``world_T_cam``: they map cam coordinates to world; neighbours match, as in
``world_T_obj = world_T_cam @ cam_T_obj``. ``world_R_obj`` is a rotation, ``world_t_obj`` an offset.
Quaternions exist only at the sim and record borders, always as ``quat_xyzw``; elsewhere 3x3
matrices.

Units are SI inside and unsuffixed by need; a name that crosses a file boundary carries its unit
(``_m _mm _s _ns _rad _deg _kg _px _steps``). Depth is float32 metres along +z, 0 where nothing
returned.

Clock: ``t_ns`` is simulated time from the start of an episode. No output holds a wall clock.

Shape letters, each with one meaning. B batch, T steps, I states (T + 1), V views, N objects
(padded, with ``valid_BN``), G goals, S candidate plans, M samples of the future, E edges, P points,
Q query points, C channels, H W image, X Y Z grid, R rows of a radial profile, D its directions,
U observations (one episode perceived under one setting), O objects of all observations
concatenated, A bodies of a scene (table, robot, objects), J joints, L robot links, F triangle
faces. ``K`` alone is the 3x3 intrinsics; an
action has 3 components.

Segmentation ids: 0 nothing, 1 table, 2 robot, 3 + i object i.
"""
