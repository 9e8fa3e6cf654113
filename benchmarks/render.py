"""Views a second on one core: ours, a loop over TinyRenderer, Embree; and whether ours and
TinyRenderer agree.

Table, arm with rod and three objects, 27 views of 128 x 128 pixels: RGB, depth and segmentation
(Embree: hits alone). Rounds of all three alternate, each timed by the processor time of this
process, so that other load weighs on all.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.embree import cast
from benchmarks.tiny import TinyScene, as_tiny_samples, parity
from oes.config import load
from oes.episode import Body, Camera, Floats
from oes.meshes.build import MeshesConfig
from oes.meshes.catalogue import Catalogue, save_catalogue, write_mesh
from oes.meshes.draft import Draft, placed
from oes.meshes.generators.mit_push import plate
from oes.meshes.generators.procedural import generate
from oes.render.renderer import Renderer
from oes.render.scene import RenderMesh, mesh_poses, scene_meshes
from oes.sim.bodies import draw_body
from oes.sim.rig import rig
from oes.sim.robot import robot_shape
from oes.sim.scene import scatter
from oes.sim.simulate import EpisodesConfig
from oes.sim.world import World

LONGEST_M = 0.08
ROUNDS = 15


def write_catalogue(cfg: MeshesConfig, folder: Path) -> Catalogue:
    """A mug, a camera and a triangular plate."""
    rng = np.random.default_rng(0)
    shapes = {
        "mug": generate("mug", 0, rng),
        "camera": generate("camera", 0, rng),
        "tri": plate("tri1", 0.08, 0.04),
    }
    for name, shape in shapes.items():
        draft = Draft(name, name, "benchmark", "generated", shape.solid, shape.parts)
        write_mesh(*placed(draft, LONGEST_M, cfg.ingest.stand), folder / name)
    return save_catalogue(folder, dict.fromkeys(shapes, "test"), [])


def random_state(
    catalogue: Catalogue, cfg: EpisodesConfig, rng: np.random.Generator
) -> tuple[list[RenderMesh], Floats, tuple[Camera, ...]]:
    """Meshes, poses and cameras of all the catalogue's objects standing apart, with the rod at some
    place.
    """
    bodies: list[Body] = [
        draw_body(mesh, cfg.sim.bodies, rng) for mesh in catalogue.meshes.values()
    ]
    poses = scatter(list(catalogue.meshes.values()), bodies, cfg.pushes.scatter, rng)
    reach = cfg.sim.robot.workspace_m / 2
    with World(catalogue, cfg.sim) as world:
        world.reset(
            bodies, poses, np.array([*rng.uniform(-reach, reach, 2), cfg.sim.robot.tip_height_m])
        )
        step = world.step(0, rig(cfg.sim.rig, rng))
    table_m = np.array(cfg.sim.physics.table_size_m)
    return (
        scene_meshes(table_m, robot_shape(cfg.sim.robot), bodies, catalogue),
        mesh_poses(step),
        step.cameras,
    )


def cpu_s(call: Callable[[], object]) -> float:
    """Processor time of one call."""
    start = time.process_time()
    call()
    return time.process_time() - start


def main() -> None:
    """Print views a second per core of each, their ratio and the parity figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--params", type=Path, default=Path("params.yaml"))
    path = parser.parse_args().params
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        catalogue = write_catalogue(load(path, "meshes", MeshesConfig), folder / "meshes")
        meshes, poses, cameras = random_state(
            catalogue, load(path, "episodes", EpisodesConfig), rng
        )
        renderer = Renderer(meshes)
        with TinyScene(meshes, poses, folder) as tiny:
            ours = renderer.render(poses, cameras)
            depth_mm, equal = parity(
                ours, tiny.render([as_tiny_samples(camera) for camera in cameras])
            )
            calls = {
                "ours": lambda: renderer.render(poses, cameras),
                "TinyRenderer": lambda: tiny.render(cameras),
                "Embree, hits only": lambda: cast(meshes, poses, cameras),
            }
            times_s = {word: np.median(rounds) for word, rounds in _alternate(calls).items()}
    print(
        f"{'':<20}{'views/s per core':>18}{'of TinyRenderer':>18}   ({os.cpu_count()} cores here)"
    )
    for word, seconds in times_s.items():
        print(
            f"{word:<20}{len(cameras) / seconds:>18.0f}{times_s['TinyRenderer'] / seconds:>17.1f}x"
        )
    print(
        f"parity: depth differs by {depth_mm:.4f} mm (median inside), {equal:.3%} of segmentation is equal"
    )


def _alternate(calls: dict[str, Callable[[], object]]) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {word: [] for word in calls}
    for _ in range(ROUNDS):
        for word, call in calls.items():
            times[word].append(cpu_s(call))
    return times


if __name__ == "__main__":
    main()
