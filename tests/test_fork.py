"""Worker processes: those that a fork makes have no threads of their parent."""

import multiprocessing
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mirrorball

ROOT = Path(__file__).resolve().parents[1]
SEQUENCE = ROOT / "samples/sequence"
SCENARIO = ROOT / "config/scenarios/demo.toml"


def visible(_: int) -> int:
    camera = mirrorball.Camera.load(SEQUENCE / "robot.toml")
    profile = mirrorball.Profile.load(SEQUENCE / "mirror.csv")
    return int(np.isfinite(mirrorball.ground_map(camera=camera, profile=profile).x_m).sum())


def line_points(_: int) -> int:
    simulation = mirrorball.Simulation(SCENARIO, seed=1)
    pipeline = simulation.pipeline()
    cycles = [pipeline.process(sample) for sample in simulation.step(None).samples]
    return sum(len(cycle.line_points) for cycle in cycles if cycle is not None)


@pytest.mark.parametrize("start", ["fork", "spawn"])
@pytest.mark.parametrize("compute", [visible, line_points])
def test_worker_processes_compute_what_their_parent_does(compute: Callable[[int], int], start: str) -> None:
    expected = compute(0)
    assert expected > 0
    with multiprocessing.get_context(start).Pool(2) as pool:
        assert pool.map_async(compute, range(4)).get(timeout=120) == 4 * [expected]
