"""Video-prediction baselines: Visual Foresight and PlaNet on overhead images (C.2, C.3).

Imports geom, render, sim and training; never dynamics, perception or mpc. Start with
``overhead_camera``, then one of ``visual_foresight`` and ``planet``.
"""

from torch import nn

from oes.baselines.planet import PlaNet
from oes.baselines.visual_foresight import VisualForesight

BASELINES: dict[str, type[nn.Module]] = {"visual_foresight": VisualForesight, "planet": PlaNet}
