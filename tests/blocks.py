"""Two simple solids and untrained networks of the smoke profile, made in a moment, and the simulator's settings."""

from pathlib import Path

import torch
import trimesh

from oes.config import load
from oes.dynamics.checkpoint import save_model
from oes.dynamics.models import OES, GraphXYZ, Seen
from oes.dynamics.train import Tasks
from oes.meshes.catalogue import Catalogue, save, write_mesh
from oes.meshes.draft import Draft, Stand, placed
from oes.percept.network import PerceptionNet
from oes.percept.perceiver import IMAGE_PX, NUM_SURFACE, Perceiver
from oes.percept.train import Perception
from oes.sim.simulate import Episodes
from oes.sim.world import Sim
from oes.video.foresight import VisualForesight
from oes.video.planet import PlaNet
from oes.video.shoot import Overheads
from oes.video.train import Video, save_video_model


def make_catalogue(folder: Path) -> Catalogue:
    """A block and a disc, 7 cm wide, both in split test."""
    solids = {"block": trimesh.creation.box((0.08, 0.06, 0.05)), "disc": trimesh.creation.cylinder(0.035, 0.05)}
    for name, solid in solids.items():
        draft = Draft(name, "solid", "test", "made", solid, (solid.convex_hull,))
        write_mesh(*placed(draft, 0.07, Stand(max_aspect=6.0, max_tilt_deg=15.0)), folder / name)
    return save(folder, dict.fromkeys(solids, "test"), [])


SMOKE = Path("params.smoke.yaml")


def make_weights(folder: Path) -> None:
    """``perception/perception.safetensors`` and models of pushing in ``dynamics/pushing-MODEL``, untrained."""
    torch.manual_seed(0)
    net = PerceptionNet(load(SMOKE, "perception", Perception).network)
    roi = net.cfg.roi
    channels = 1 + NUM_SURFACE + net.cfg.map_features
    cylinder = net.cfg.surface.cylinder
    seen = Seen(channels, roi.count, roi.voxel_m, IMAGE_PX, cylinder.rows, cylinder.directions)
    for word, kind in (("oes", OES), ("graph_xyz", GraphXYZ)):
        (folder / "dynamics" / f"pushing-{word}").mkdir(parents=True)
        save_model(folder / "dynamics" / f"pushing-{word}", kind(load(SMOKE, "dynamics", Tasks).pushing.net, seen))
    frames, video = load(SMOKE, "frames", Overheads), load(SMOKE, "video", Video)
    for word, model in (
        ("visual_foresight", VisualForesight(video.visual_foresight.net)),
        ("planet", PlaNet(video.planet.net)),
    ):
        (folder / "dynamics" / f"pushing-{word}").mkdir()
        save_video_model(folder / "dynamics" / f"pushing-{word}", model, frames.view)
    (folder / "perception").mkdir()
    Perceiver(net, torch.device("cpu")).save(folder / "perception" / "perception.safetensors")


def read_sim() -> Sim:
    """That of params.yaml."""
    return load(Path("params.yaml"), "episodes", Episodes).sim
