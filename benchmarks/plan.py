"""Forecast time (ms) of each model for a set of plans: 30 of 1 step and 60 of 10 steps."""

import argparse
import time
from pathlib import Path

import torch

from oes.config import load
from oes.dynamics import MODELS
from oes.dynamics.models import GraphModel, InputSpec
from oes.dynamics.train import DynamicsConfig
from oes.dynamics.unroll import DynamicsModel, initial_state, unroll_mean
from oes.objects import Objects

PLANS = ((30, 1), (60, 10))
NUM_OBJECTS = 2
REPEATS = 50
INPUTS = InputSpec(
    crop_channels=11,
    crop_side=16,
    voxel_m=0.01,
    image_side_px=32,
    profile_rows=10,
    profile_directions=64,
)


def scene(inputs: InputSpec) -> Objects:
    """One scene of two objects and one view."""
    shape = (1, NUM_OBJECTS)
    return Objects(
        center_N3=torch.rand(*shape, 3) * 0.2,
        size_N3=torch.full((*shape, 3), 0.08),
        score_N=torch.ones(shape),
        valid_N=torch.ones(shape, dtype=torch.bool),
        crop_NCXYZ=torch.rand(*shape, inputs.crop_channels, *[inputs.crop_side] * 3),
        image_NV3HW=torch.zeros(
            *shape, 1, 3, inputs.image_side_px, inputs.image_side_px, dtype=torch.uint8
        ),
        camera_NV12=torch.zeros(*shape, 1, 12),
        view_NV=torch.ones(*shape, 1, dtype=torch.bool),
        radial_profile_NRD3=torch.tensor([0.035, 0.002, 1.0]).expand(
            *shape, inputs.profile_rows, inputs.profile_directions, 3
        ),
        com_offset_N3=torch.zeros(*shape, 3),
    )


@torch.inference_mode()
def plan_ms(model: DynamicsModel, objects: Objects, samples: int, horizon: int) -> float:
    """Median time to encode the appearance and to unroll ``samples`` plans of ``horizon`` steps."""
    actions = torch.randn(samples, horizon, 3) * 0.04
    tip, times = torch.zeros(samples, 3), []
    for _ in range(REPEATS):
        start = time.perf_counter()
        appearance = model.appearance(objects)
        state = initial_state(
            *(x.expand(samples, *x.shape[1:]) for x in (objects.center_N3, objects.valid_N))
        )
        unroll_mean(model, appearance.expand(samples, *appearance.shape[1:]), state, tip, actions)
        times.append((time.perf_counter() - start) * 1e3)
    return sorted(times)[REPEATS // 2]


def main() -> None:
    """Print a line per model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--params", type=Path, default=Path("params.yaml"))
    cfg = load(parser.parse_args().params, "dynamics", DynamicsConfig).pushing
    torch.manual_seed(0)
    objects = scene(INPUTS)
    header = "".join(f"{f'{samples}x{horizon} ms':>12}" for samples, horizon in PLANS)
    print(f"{'model':<24}{header}   ({torch.get_num_threads()} threads)")
    for name, model_class in MODELS.items():
        if issubclass(model_class, GraphModel):
            model = model_class(cfg.net, INPUTS).eval()
            times = [plan_ms(model, objects, samples, horizon) for samples, horizon in PLANS]
            print(f"{name:<24}" + "".join(f"{ms:>12.1f}" for ms in times))


if __name__ == "__main__":
    main()
