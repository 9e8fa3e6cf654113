"""Columns of every CSV file of raw rows that a stage writes and ``report`` reads, and the names of
all models. Imports nothing, so both sides share it without torch.

Types: ``str``, ``int``, ``float``, ``bool`` (True/False or 1/0); ``float?`` may be empty.
"""

from collections.abc import Mapping

Columns = Mapping[str, str]

_OPTIONAL = "float?"
BOX = ("x_m", "y_m", "z_m", "width_m", "depth_m", "height_m")

ERRORS: Columns = {  # rollouts/<task>-<model>/errors.csv
    **dict.fromkeys(("task", "model", "setting", "split"), "str"),
    **dict.fromkeys(("episode_i", "object_i", "num_objects", "num_views", "T"), "int"),
    **dict.fromkeys(("translation_mm", "rotation_deg", "surface_mm"), "float"),
    **dict.fromkeys(("moved", "detected"), "bool"),
    "penetration_mm": "float",
    **dict.fromkeys(("sigma_mm", "within_50", "within_90", "nll", "nll_homoscedastic"), _OPTIONAL),
}

DETECTIONS: Columns = {  # objects/<task>-<split>/detections.csv
    **dict.fromkeys(("episode", "step", "num_views"), "int"),
    **dict.fromkeys(("score", "iou", "centre_mm", "mask_iou", "chamfer_mm"), _OPTIONAL),
    **dict.fromkeys(("normal_deg", *BOX, *(f"true_{name}" for name in BOX)), _OPTIONAL),
}

VIEWS: Columns = {  # objects/<task>-<split>/views.csv
    **dict.fromkeys(("episode", "step", "num_views", "camera"), "int"),
    **dict.fromkeys(("psnr_db", "ssim"), "float"),
}

TRIALS: Columns = {  # trials/<scenario>-<model>/trials.csv
    **dict.fromkeys(("scenario", "model", "planner"), "str"),
    **dict.fromkeys(("plans", "horizon", "trial_i", "num_objects"), "int"),
    **dict.fromkeys(("success", "all_success", "collided"), "bool"),
    **dict.fromkeys(("initial_mm", "mean_final_mm", "estimated_mm"), "float"),
    "steps_used": "int",
    **dict.fromkeys(("failure", "video"), "str"),
}

RENDERS: Columns = {  # futures/<task>/renders.csv
    **{"task": "str", "episode_i": "int", "T": "int", "source": "str"},
    **dict.fromkeys(("psnr_db", "ssim", "objects_psnr_db", "feature_error"), _OPTIONAL),
}

CONSISTENCY: Columns = {  # futures/<task>/consistency.csv
    **{"task": "str", "episode_i": "int", "T": "int", "source": "str", "object_i": "int"},
    **dict.fromkeys(("views_found", "centre_mm", "spread_mm"), _OPTIONAL),
}

EDITS: Columns = {  # futures/<task>/edits.csv
    **{"task": "str", "episode_i": "int", "edit": "str", "model": "str"},
    **{"object_i": "int", "T": "int", "translation_mm": "float", "rotation_deg": "float"},
    "detected": "bool",
}

FUTURES: Mapping[str, Columns] = {"renders": RENDERS, "consistency": CONSISTENCY, "edits": EDITS}

FORECASTS: Columns = {  # dynamics/pushing-<visual_foresight or planet>/forecasts.csv
    **dict.fromkeys(("clip", "T"), "int"),
    **dict.fromkeys(("psnr_db", "ssim", "still_psnr_db", "still_ssim"), "float"),
    **dict.fromkeys(("error_mm", "still_mm"), "float"),
}

MODEL_LABELS = {
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
"""Models and their labels, in the order of every table."""

IMAGE_MODELS = ("visual_foresight", "planet")
"""Models that forecast images, not objects."""

VARIANT_LABELS = {
    "contact_gt": "+ ground-truth surfaces",
    "contact_noaug": "- augmentation",
    "contact_onestep": "- unroll (single steps)",
    "contact_300": "300 episodes",
    "contact_100": "100 episodes",
}
"""Ablations of ``contact``: the same model under other training settings."""
