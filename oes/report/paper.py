"""Numbers printed in the paper (Tables 1 to 3), shown beside the measured ones."""

from collections.abc import Mapping

Printed = Mapping[str, Mapping[str, tuple[float, float, float]]]
"""Model -> metric -> values at T = 1, 3, 5."""

# Task, setting, model; translation (mm) and rotation (deg) at T = 1, 3, 5. Table 1: pushing, two
# novel objects; Table 2: falling, three to four.
_ERRORS = """
pushing 3views_gt  graph_xyz              4.6 32.1  66.3  2.8 16.7  26.4
pushing 3views_gt  graph_xyz_image        6.0 39.3  69.7  3.4 29.8  30.7
pushing 3views_gt  oes                    3.6 22.5  43.4  2.5 12.0  20.6
pushing 1view_gt   graph_xyz_image        6.0 39.3  69.7  3.4 29.8  30.7
pushing 1view_gt   oes                    4.1 23.6  43.8  3.1 12.2  20.3
pushing 1view_pred graph_xyz              6.7 35.4  68.2  3.0 20.1  30.32
pushing 1view_pred graph_xyz_image        6.6 43.1  71.2  3.6 31.8  32.4
pushing 1view_pred oes                    4.3 25.2  47.0  2.7 12.1  19.7
pushing fixed_pred graph_xyz_image_fixed  5.1 29.6  54.5  2.6 11.0  16.9
falling 1view_pred graph_xyz              5.2 11.7 278.6  5.7 10.4  43.28
falling 1view_pred graph_xyz_image        8.4 17.0 620.2  9.2 16.6 117.9
falling 1view_pred oes                    5.0 13.1  16.4  6.1 12.6  18.7
"""


def _read_errors() -> dict[str, dict[str, dict[str, dict[str, tuple[float, float, float]]]]]:
    found: dict[str, dict[str, dict[str, dict[str, tuple[float, float, float]]]]] = {}
    for line in _ERRORS.split("\n")[1:-1]:
        task, setting, model, *cells = line.split()
        mm_1, mm_3, mm_5, deg_1, deg_3, deg_5 = map(float, cells)
        values = {"translation_mm": (mm_1, mm_3, mm_5), "rotation_deg": (deg_1, deg_3, deg_5)}
        found.setdefault(task, {}).setdefault(setting, {})[model] = values
    return found


PAPER_ERRORS = _read_errors()
"""By task, setting, model and metric."""

PAPER_SUCCESS = {
    "targets": {
        **{"graph_xyz": 0.76, "graph_xyz_image": 0.70, "visual_foresight": 0.32},
        **{"planet": 0.16, "oes": 0.86},
    },
    "obstacle": {"oes": 0.68},
}
"""Share of 50 trials that succeed, by scenario and model (Table 3 and appendix C.3)."""
