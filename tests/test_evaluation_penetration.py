"""Penetration depth of forecast poses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oes.config import load
from oes.evaluation.penetration import PenetrationMeter
from oes.sim.simulate import EpisodesConfig, simulate
from tests.blocks import make_catalogue


def test_penetration_is_the_depth_of_a_surface_inside_a_solid(tmp_path: Path) -> None:
    """A block of 70 x 52.5 x 43.75 mm beside another body, at growing overlap along x, then above
    it.
    """
    catalogue = make_catalogue(tmp_path)
    episode = simulate(
        catalogue, load(Path("params.yaml"), "episodes", EpisodesConfig), "pushing", "test2", 0
    )
    block = replace(episode.bodies[0], mesh="block", scale_3=np.ones(3))
    episode = replace(episode, bodies=(block, block))
    visual = catalogue.meshes["block"].visual
    points = {"block": np.asarray(visual.sample(20000, seed=0))}
    width, height = visual.extents[0], visual.extents[2]
    poses = np.tile(np.eye(4), (4, 2, 1, 1))
    for t, (x, z) in enumerate(
        [(width + 0.001, 0), (width - 0.002, 0), (width - 0.006, 0), (0, height + 0.01)]
    ):
        poses[t, 1, :3, 3] = [x, 0, z]
    found = PenetrationMeter(catalogue, points).depths_mm(episode, poses)
    assert found.shape == (4, 2)
    assert found[0].tolist() == [0, 0] == found[3].tolist()
    assert found[1] == pytest.approx([2.0, 2.0], abs=0.1) and found[2] == pytest.approx(
        [6.0, 6.0], abs=0.2
    )
