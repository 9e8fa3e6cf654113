"""Numbers printed in the paper (Tables 1 to 3), shown beside the measured ones."""

from collections.abc import Mapping

Printed = Mapping[str, Mapping[str, tuple[float, float, float]]]
"""Model -> metric -> values at T = 1, 3, 5."""

# By task and setting (Table 1: pushing, two novel objects; Table 2: falling, three to four).
PAPER_ERRORS: dict[str, dict[str, Printed]] = {
    "pushing": {
        "3views_gt": {
            "graph_xyz": {"translation_mm": (4.6, 32.1, 66.3), "rotation_deg": (2.8, 16.7, 26.4)},
            "graph_xyz_image": {
                "translation_mm": (6.0, 39.3, 69.7),
                "rotation_deg": (3.4, 29.8, 30.7),
            },
            "oes": {"translation_mm": (3.6, 22.5, 43.4), "rotation_deg": (2.5, 12.0, 20.6)},
        },
        "1view_gt": {
            "graph_xyz_image": {
                "translation_mm": (6.0, 39.3, 69.7),
                "rotation_deg": (3.4, 29.8, 30.7),
            },
            "oes": {"translation_mm": (4.1, 23.6, 43.8), "rotation_deg": (3.1, 12.2, 20.3)},
        },
        "1view_pred": {
            "graph_xyz": {"translation_mm": (6.7, 35.4, 68.2), "rotation_deg": (3.0, 20.1, 30.32)},
            "graph_xyz_image": {
                "translation_mm": (6.6, 43.1, 71.2),
                "rotation_deg": (3.6, 31.8, 32.4),
            },
            "oes": {"translation_mm": (4.3, 25.2, 47.0), "rotation_deg": (2.7, 12.1, 19.7)},
        },
        "fixed_pred": {
            "graph_xyz_image_fixed": {
                "translation_mm": (5.1, 29.6, 54.5),
                "rotation_deg": (2.6, 11.0, 16.9),
            }
        },
    },
    "falling": {
        "1view_pred": {
            "graph_xyz": {"translation_mm": (5.2, 11.7, 278.6), "rotation_deg": (5.7, 10.4, 43.28)},
            "graph_xyz_image": {
                "translation_mm": (8.4, 17.0, 620.2),
                "rotation_deg": (9.2, 16.6, 117.9),
            },
            "oes": {"translation_mm": (5.0, 13.1, 16.4), "rotation_deg": (6.1, 12.6, 18.7)},
        }
    },
}

# scenario -> model -> share of 50 trials that succeed (Table 3 and appendix C.3)
PAPER_SUCCESS: dict[str, dict[str, float]] = {
    "targets": {
        "graph_xyz": 0.76,
        "graph_xyz_image": 0.70,
        "visual_foresight": 0.32,
        "planet": 0.16,
        "oes": 0.86,
    },
    "obstacle": {"oes": 0.68},
}
