"""Views per second on one core: ``oes.render``, TinyRenderer and Embree; and parity with
TinyRenderer.

Table, arm with rod and three objects, 27 views of 128 x 128 pixels: RGB, depth and segmentation
(Embree: hits only). Repetitions of all three alternate and count processor time, so that other load
affects all alike.
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
REPEATS = 15


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
    """Meshes, poses and cameras of all objects of a catalogue, scattered, with a random tip."""
    bodies: list[Body] = [
        draw_body(mesh, cfg.sim.bodies, rng) for mesh in catalogue.meshes.values()
    ]
    poses = scatter(list(catalogue.meshes.values()), bodies, cfg.pushes.scatter, rng)
    half_m = cfg.sim.robot.workspace_m / 2
    with World(catalogue, cfg.sim) as world:
        world.reset(
            bodies, poses, np.array([*rng.uniform(-half_m, half_m, 2), cfg.sim.robot.tip_height_m])
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
    """Print views per second and core of each, their ratio, and the parity."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--params", type=Path, default=Path("params.yaml"))
    path = parser.parse_args().params
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder_name:
        folder = Path(folder_name)
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
                "oes.render": lambda: renderer.render(poses, cameras),
                "TinyRenderer": lambda: tiny.render(cameras),
                "Embree, hits only": lambda: cast(meshes, poses, cameras),
            }
            times_s = {name: np.median(times) for name, times in _alternate(calls).items()}
    header = f"{'':<20}{'views/s per core':>18}{'speed-up':>18}"
    print(f"{header}   ({os.cpu_count()} cores)")
    for name, time_s in times_s.items():
        speed_up = times_s["TinyRenderer"] / time_s
        print(f"{name:<20}{len(cameras) / time_s:>18.0f}{speed_up:>17.1f}x")
    print(f"parity: median depth difference {depth_mm:.4f} mm away from edges, ", end="")
    print(f"{equal:.3%} of segmentation ids equal")


def _alternate(calls: dict[str, Callable[[], object]]) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(REPEATS):
        for name, call in calls.items():
            times[name].append(cpu_s(call))
    return times


if __name__ == "__main__":
    main()
