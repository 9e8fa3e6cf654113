"""Perception time (ms) with one and three views: encoding, detection, masks and crops."""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from oes.config import load
from oes.episode import Camera, Frames
from oes.geom.camera import intrinsics, look_at
from oes.perception.network import PerceptionNet
from oes.perception.perceiver import Perceiver
from oes.perception.train import PerceptionConfig

VIEWS = (1, 3)
IMAGE_PX = 128
REPEATS = 20


def views(count: int) -> tuple[Frames, list[Camera]]:
    """Images of an empty table from ``count`` sides; their content does not change the cost."""
    target, shape = np.array([0.0, 0.0, 0.1]), (count, IMAGE_PX, IMAGE_PX)
    positions = [
        np.array([np.cos(a) * 0.77, np.sin(a) * 0.77, 0.74]) for a in np.linspace(-1, 1, count)
    ]
    K_33, size_px = intrinsics(42.0, IMAGE_PX, IMAGE_PX), (IMAGE_PX, IMAGE_PX)
    cameras = [
        Camera(f"cam_{i}", K_33, look_at(position, target), *size_px)
        for i, position in enumerate(positions)
    ]
    depth = np.full(shape, 1.05, np.float32)
    return Frames(np.full((*shape, 3), 128, np.uint8), depth, np.ones(shape, np.uint8)), cameras


def median_ms(call: Callable[[], object]) -> float:
    """Median wall-clock time of a call."""
    times = []
    for _ in range(REPEATS + 2):
        start = time.perf_counter()
        call()
        times.append((time.perf_counter() - start) * 1e3)
    return sorted(times[2:])[REPEATS // 2]


def main() -> None:
    """Print one line for each number of views."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--params", type=Path, default=Path("params.yaml"))
    cfg = load(parser.parse_args().params, "perception", PerceptionConfig)
    torch.manual_seed(0)
    perceiver = Perceiver(PerceptionNet(cfg.network), torch.device("cpu"))
    boxes = (
        torch.tensor([[0.0, 0.1, 0.03], [0.0, -0.1, 0.03]]),
        torch.full((2, 3), 0.1),
        torch.ones(2),
    )
    header = f"{'views':<8}{'encode ms':>12}{'detect ms':>12}{'objects ms':>12}"
    print(f"{header}   ({torch.get_num_threads()} threads)")
    for count in VIEWS:
        frames, cameras = views(count)
        scene = perceiver.encode(frames, cameras)
        encode = median_ms(lambda frames=frames, cameras=cameras: perceiver.encode(frames, cameras))
        detect = median_ms(lambda scene=scene: perceiver.detect(scene))
        objects = median_ms(lambda s=scene, f=frames, c=cameras: perceiver.objects(s, boxes, f, c))
        print(f"{count:<8}{encode:>12.1f}{detect:>12.1f}{objects:>12.1f}")


if __name__ == "__main__":
    main()
