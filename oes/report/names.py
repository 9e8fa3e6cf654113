"""How models and settings are called and ordered in every table and figure."""

from collections.abc import Iterable

MODELS = {
    "static": "nothing moves",
    "graph_xyz": "graph-XYZ",
    "graph_xyz_image": "graph-XYZ-image",
    "graph_xyz_image_fixed": "graph-XYZ-image, fixed view",
    "visual_foresight": "Visual Foresight",
    "planet": "PlaNet",
    "oes": "3D-OES",
    "contact": "Contact",
    "simulator": "simulator",
}

OURS, BASELINE, SURFACES = "oes", "graph_xyz", "contact"

VARIANTS = {
    "contact_gt": "+ true surfaces",
    "contact_noaug": "- augmentation",
    "contact_onestep": "- unroll (single steps)",
    "contact_300": "300 episodes",
    "contact_100": "100 episodes",
}
"""Models trained otherwise, that only the table of ablations shows."""

SETTINGS = {
    "3views_gt": "3 views, true boxes",
    "1view_gt": "1 view, true boxes",
    "1view_pred": "1 view, predicted boxes",
    "fixed_pred": "1 fixed view, predicted boxes",
}

SCENARIOS = {
    "targets": "to targets",
    "obstacle": "around an obstacle",
    "obstacle_2": "around two obstacles",
    "obstacle_3": "around three obstacles",
}

METRICS = {
    "translation_mm": "translation (mm)",
    "rotation_deg": "rotation (deg)",
    "surface_mm": "surface distance (mm)",
}

# Okabe and Ito's palette: told apart by colour-blind eyes.
COLOURS = {
    "static": "#999999",
    "graph_xyz": "#e69f00",
    "graph_xyz_image": "#56b4e9",
    "graph_xyz_image_fixed": "#009e73",
    "visual_foresight": "#0072b2",
    "planet": "#cc79a7",
    "oes": "#d55e00",
    "contact": "#882255",
    "simulator": "#000000",
}


def in_order(models: Iterable[str]) -> list[str]:
    """Models of the study in the study's order, then any others by name."""
    order = list(MODELS)
    return sorted(
        set(models), key=lambda name: (order.index(name) if name in order else len(order), name)
    )
