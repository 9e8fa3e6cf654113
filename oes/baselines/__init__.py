"""Baselines that forecast pictures: Visual Foresight and PlaNet, from a fixed camera above the
table (C.2, C.3).
"""

from torch import nn

from oes.baselines.planet import PlaNet
from oes.baselines.visual_foresight import VisualForesight

BASELINES: dict[str, type[nn.Module]] = {"visual_foresight": VisualForesight, "planet": PlaNet}
