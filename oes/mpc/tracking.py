"""Tracking by detection: data association, and coasting of objects that are not detected."""

from oes.episode import Bools, Floats
from oes.geom.assignment import assign


def update_tracks(
    center_N3: Floats,
    size_N3: Floats,
    detected_center_P3: Floats,
    detected_size_P3: Floats,
    gate_m: float,
) -> tuple[Floats, Floats, Bools]:
    """New centres N3, sizes N3 and a mask N of detected objects (metres, world).

    An object without a detection within ``gate_m`` of its predicted centre keeps its estimate.
    """
    match_N = assign(center_N3, detected_center_P3, gate_m)
    is_detected_N = match_N >= 0
    center_N3, size_N3 = center_N3.copy(), size_N3.copy()
    center_N3[is_detected_N] = detected_center_P3[match_N[is_detected_N]]
    size_N3[is_detected_N] = detected_size_P3[match_N[is_detected_N]]
    return center_N3, size_N3, is_detected_N
