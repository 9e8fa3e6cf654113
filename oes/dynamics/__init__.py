"""Object dynamics: a graph network unrolled through time, what it is compared with, and its
training.
"""

from torch import nn

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

VARIANTS = dict.fromkeys(
    ("contact_gt", "contact_noaug", "contact_onestep", "contact_100", "contact_300"), "contact"
)
"""Models of ``MODELS`` trained otherwise, for the ablations, by word."""
