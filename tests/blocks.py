"""Two simple solids, untrained networks of the smoke profile and the simulator's settings."""

from pathlib import Path

import torch
import trimesh

from oes.baselines.overhead_render import OverheadConfig
from oes.baselines.planet import PlaNet
from oes.baselines.train import BaselinesConfig, save_baseline
from oes.baselines.visual_foresight import VisualForesight
from oes.config import load
from oes.dynamics.checkpoint import save_model
from oes.dynamics.models import OES, GraphXYZ, InputSpec
from oes.dynamics.train import DynamicsConfig
from oes.meshes.catalogue import Catalogue, save_catalogue, write_mesh
from oes.meshes.draft import Draft, StandConfig, placed
from oes.perception.network import PerceptionNet
from oes.perception.perceiver import IMAGE_PX, NUM_SURFACE, Perceiver
from oes.perception.train import PerceptionConfig
from oes.sim.simulate import EpisodesConfig
from oes.sim.world import SimConfig


def make_catalogue(folder: Path) -> Catalogue:
    """A block and a disc, 7 cm wide, both in split 'test'."""
    solids = {
        "block": trimesh.creation.box((0.08, 0.06, 0.05)),
        "disc": trimesh.creation.cylinder(0.035, 0.05),
    }
    for name, solid in solids.items():
        draft = Draft(name, "solid", "test", "made", solid, (solid.convex_hull,))
        write_mesh(
            *placed(draft, 0.07, StandConfig(max_aspect=6.0, max_tilt_deg=15.0)), folder / name
        )
    return save_catalogue(folder, dict.fromkeys(solids, "test"), [])


SMOKE = Path("params.smoke.yaml")


def make_weights(folder: Path) -> None:
    """``perception/perception.safetensors`` and models of pushing in ``dynamics/pushing-MODEL``,
    untrained.
    """
    torch.manual_seed(0)
    net = PerceptionNet(load(SMOKE, "perception", PerceptionConfig).network)
    roi = net.cfg.roi
    channels = 1 + NUM_SURFACE + net.cfg.map_features
    cylinder = net.cfg.surface.cylinder
    inputs = InputSpec(
        channels, roi.count, roi.voxel_m, IMAGE_PX, cylinder.num_rows, cylinder.num_directions
    )
    for name, model_class in (("oes", OES), ("graph_xyz", GraphXYZ)):
        (folder / "dynamics" / f"pushing-{name}").mkdir(parents=True)
        save_model(
            folder / "dynamics" / f"pushing-{name}",
            model_class(load(SMOKE, "dynamics", DynamicsConfig).pushing.net, inputs),
        )
    frames, video = (
        load(SMOKE, "overhead", OverheadConfig),
        load(SMOKE, "baselines", BaselinesConfig),
    )
    for name, model in (
        ("visual_foresight", VisualForesight(video.visual_foresight.net)),
        ("planet", PlaNet(video.planet.net)),
    ):
        (folder / "dynamics" / f"pushing-{name}").mkdir()
        save_baseline(folder / "dynamics" / f"pushing-{name}", model, frames.view)
    (folder / "perception").mkdir()
    Perceiver(net, torch.device("cpu")).save(folder / "perception" / "perception.safetensors")


def read_sim() -> SimConfig:
    """The simulator's settings in params.yaml."""
    return load(Path("params.yaml"), "episodes", EpisodesConfig).sim
