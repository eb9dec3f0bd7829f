"""Worker processes: those that a fork makes have no threads of their parent."""

import multiprocessing
from pathlib import Path

import numpy as np
import pytest

import mirrorball

SEQUENCE = Path(__file__).resolve().parents[1] / "samples/sequence"


def visible(_: int) -> int:
    camera = mirrorball.Camera.load(SEQUENCE / "robot.toml")
    profile = mirrorball.Profile.load(SEQUENCE / "mirror.csv")
    return int(np.isfinite(mirrorball.ground_map(camera=camera, profile=profile).x_m).sum())


@pytest.mark.parametrize("start", ["fork", "spawn"])
def test_worker_processes_compute_what_their_parent_does(start: str) -> None:
    expected = visible(0)
    with multiprocessing.get_context(start).Pool(2) as pool:
        assert pool.map_async(visible, range(4)).get(timeout=120) == 4 * [expected]
