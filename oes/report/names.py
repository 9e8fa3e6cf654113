"""Names, labels, order and colours of models, settings, scenarios and metrics."""

from collections.abc import Iterable

from oes.schema import MODEL_LABELS, VARIANT_LABELS

OURS, BASELINE, CONTACT = "oes", "graph_xyz", "contact"
VARIED, FIXED = "1view_pred", "fixed_pred"
SHOWN_T = (1, 3, 5)
LAST = SHOWN_T[-1]

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

SOURCES = {
    "truth": "true motion",
    "encoded": "encoded from the future itself",
    "photograph": "photographs",
}
"""References that stand beside the models in the tables of rendered futures."""

EDIT_LABELS = {
    "none": "unchanged",
    "move": "one object moved",
    "resize": "one object resized",
    "remove": "one object removed",
    "add": "one object added",
    "push": "another push",
}

# Okabe and Ito's palette, distinguishable under colour blindness.
MODEL_COLOURS = {
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

CONTACT_NOTE = (
    "Contact's prior uses Bullet's solver scheme and the data set's nominal constants (mass and "
    "friction), so it is not a purely learned simulator."
)


def label(model: str) -> str:
    """Label of a model, a variant or a reference; any other name stays as it is."""
    return {**MODEL_LABELS, **VARIANT_LABELS, **SOURCES}.get(model, model)


def in_order(models: Iterable[str]) -> list[str]:
    """Distinct models in the order of the tables, then any other names alphabetically."""
    order = [*MODEL_LABELS, *VARIANT_LABELS]
    return sorted(
        set(models), key=lambda name: (order.index(name) if name in order else len(order), name)
    )


def views_key(num_views: int) -> str:
    """``1view``, ``3views``."""
    return f"{num_views}view" + "s" * (num_views > 1)
