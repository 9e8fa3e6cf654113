"""Baselines that forecast pictures: Visual Foresight and PlaNet, from a fixed camera above the table (C.2, C.3)."""

from torch import nn

from oes.video.foresight import VisualForesight
from oes.video.planet import PlaNet

VIDEO_MODELS: dict[str, type[nn.Module]] = {"visual_foresight": VisualForesight, "planet": PlaNet}
