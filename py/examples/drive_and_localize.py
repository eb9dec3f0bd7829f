"""Drive a simulated robot in a circle and compare what it knows with the truth: `python drive_and_localize.py --seconds 5`.

The same loop works on a real robot: give `Pipeline(robot="robot.toml")` the images and wheel increments of your own drivers.
"""

import argparse
from pathlib import Path

import numpy as np

from mirrorball import Simulation

SCENARIO = Path(__file__).parents[2] / "config/scenarios/tracks_18x12.toml"


def main(seconds: float) -> None:
    """Drives, prints the pose of each tenth image, and the median error."""
    simulation = Simulation(SCENARIO, seed=1)
    pipeline = simulation.pipeline()
    errors = []
    for number in range(round(30 * seconds)):
        step = simulation.step([1.0, 0.0, 0.5])
        for sample in step.samples:
            cycle = pipeline.process(sample)
        if cycle is None or cycle.pose is None:
            continue
        truth = step.truth.pose
        errors.append(np.hypot(cycle.pose.x_m - truth.x_m, cycle.pose.y_m - truth.y_m))
        if number % 10 == 0:
            std_cm = 100.0 * np.sqrt(np.diag(cycle.covariance)[:2])
            print(f"{cycle.stamp_s:6.2f} s  {cycle.mode:8}  error {100 * errors[-1]:.2f} cm, stated {std_cm.round(2)} cm")
    print(f"median error {100 * np.median(errors):.2f} cm in {len(errors)} images")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    main(parser.parse_args().seconds)
