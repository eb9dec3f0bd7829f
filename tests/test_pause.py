"""What does a run do after its process was stopped for a while (SIGSTOP)? It goes on with what the devices send then."""

import bisect
import csv
import math
import signal
import time
from pathlib import Path

import pytest

from test_robot import StateOutput, ended, hardware, start, states, stop  # noqa: F401


def rows(path: Path) -> list[dict[str, float]]:
    with path.open() as file:
        table = list(csv.DictReader(file))
    keys = ("stamp_s", "x_m", "y_m", "theta_rad")
    return [{key: float(row[key]) for key in keys} for row in table if row["x_m"]]


@pytest.mark.parametrize("pause_s", [0.4, 3.0])
def test_nothing_from_before_or_during_a_pause_becomes_a_pose_and_no_device_is_blamed(
    pause_s: float,
    tmp_path: Path,
    states: StateOutput,  # noqa: F811
) -> None:
    robot = tmp_path / "robot"
    sim = hardware(robot, "--own-path", "--truth", tmp_path / "truth.csv")
    run = start("run", "--robot", robot, "--out", tmp_path / "poses.csv", "--network", states.network, "--json")
    states.wait(60)
    stop(run)
    stopped = time.monotonic()
    time.sleep(pause_s)
    resumed = time.monotonic()
    run.send_signal(signal.SIGCONT)
    # Those that were sent before the pause count, too.
    states.wait(60)
    while time.monotonic() < resumed + 1.5:
        states.wait(1)
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    changes = [change for change in report["changes"] if change["stamp_s"] > stopped]
    assert len(changes) == 3 and all("paused" in change["reason"] for change in changes), changes
    assert [device["state"] for device in report["devices"]] == ["running"] * 3
    poses, truth = rows(tmp_path / "poses.csv"), rows(tmp_path / "truth.csv")
    stamps = [pose["stamp_s"] for pose in poses]
    assert stamps == sorted(set(stamps))
    assert not [stamp for stamp in stamps if stopped < stamp < resumed]
    truth_stamps = [row["stamp_s"] for row in truth]
    after = [pose for pose in poses if resumed < pose["stamp_s"] < truth_stamps[-1]]
    assert len(after) > 20
    for pose in after:
        index = max(1, bisect.bisect_left(truth_stamps, pose["stamp_s"]))
        before, behind = truth[index - 1], truth[index]
        share = (pose["stamp_s"] - before["stamp_s"]) / (behind["stamp_s"] - before["stamp_s"])
        x_m, y_m = (before[key] + share * (behind[key] - before[key]) for key in ("x_m", "y_m"))
        turned_rad = math.remainder(behind["theta_rad"] - before["theta_rad"], math.tau)
        error_rad = math.remainder(pose["theta_rad"] - before["theta_rad"] - share * turned_rad, math.tau)
        # An image of before the pause with the stamp of its arrival is decimetres wrong.
        assert math.dist((pose["x_m"], pose["y_m"]), (x_m, y_m)) < 0.1 and abs(error_rad) < 0.05, (pose, before)
