"""Object dynamics: models that forecast motion from perceived objects, and their training.

May import ``config``, ``schema``, ``geom``, ``objects``, ``metrics`` and ``training``; never the
simulator. Start with ``unroll`` (the interface of all models), then ``graph`` and ``models``.
"""

from torch import nn

from oes import schema
from oes.dynamics.contact import Contact
from oes.dynamics.models import OES, GraphXYZ, GraphXYZImage, GraphXYZImageFixed
from oes.dynamics.reference_models import Simulator, Static

MODELS: dict[str, type[nn.Module]] = {
    "static": Static,
    "simulator": Simulator,
    "oes": OES,
    "contact": Contact,
    "graph_xyz": GraphXYZ,
    "graph_xyz_image": GraphXYZImage,
    "graph_xyz_image_fixed": GraphXYZImageFixed,
}

VARIANTS = dict.fromkeys(schema.VARIANT_LABELS, "contact")
"""Ablations: models of ``MODELS`` under other training settings, by name."""
