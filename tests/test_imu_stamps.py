"""Readings of an inertial unit that a busy computer stamps in bursts, and images without a line."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from mirrorball import Simulation
from mirrorball.samples import ImageSample, ImuSample

DEMO = Path(__file__).parents[1] / "config/scenarios/demo.toml"
BLIND_S = (5.0, 8.0)


@pytest.mark.parametrize("burst_s", [0.0, 0.02, 0.03])
def test_dead_reckoning_survives_readings_that_are_stamped_in_bursts(burst_s: float) -> None:
    """Each reading within `burst_s` is stamped at its end, 2 % of the true times apart: metres off before."""
    simulation = Simulation(DEMO, seed=1)
    pipeline = simulation.pipeline()
    black = np.zeros((480, 480, 3), np.uint8)
    errors = []
    step = simulation.step(None)
    while step.truth.stamp_s < BLIND_S[1]:
        for sample in step.samples:
            if isinstance(sample, ImageSample) and sample.stamp_s > BLIND_S[0]:
                cycle = pipeline.image(sample.stamp_s, black)
                assert cycle.pose is not None
                truth = step.truth.pose
                errors.append(math.hypot(cycle.pose.x_m - truth.x_m, cycle.pose.y_m - truth.y_m))
                continue
            if isinstance(sample, ImuSample) and burst_s > 0.0:
                start = math.floor(sample.stamp_s / burst_s) * burst_s
                late = start + burst_s + 0.02 * (sample.stamp_s - start)
                sample = dataclasses.replace(sample, stamp_s=late)
            pipeline.process(sample)
        step = simulation.step(None)
    assert max(errors) < (0.05 if burst_s == 0.0 else 0.15)
