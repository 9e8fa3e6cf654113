"""Object dynamics: a graph network unrolled through time, what it is compared with, and its training."""

from torch import nn

from oes.dynamics.bounds import Simulator, Static
from oes.dynamics.models import OES, GraphXYZ, GraphXYZImage, GraphXYZImageFixed

MODELS: dict[str, type[nn.Module]] = {
    "static": Static,
    "simulator": Simulator,
    "oes": OES,
    "graph_xyz": GraphXYZ,
    "graph_xyz_image": GraphXYZImage,
    "graph_xyz_image_fixed": GraphXYZImageFixed,
}
