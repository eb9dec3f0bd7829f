"""Do wheels, latency and inertial unit of a drive come out as they were, and do the poses improve with the files?

The drive is simulated, with slip, rocking, noise and unequal wheels. Its images are then delayed and its unit turned.
"""

import csv
import json
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from test_robot import PROGRAM, ROOT

# What differs from robot.toml: factors of the wheels' radii (of the scenario), mounting of the unit, delay of the images.
RADII = [0.0525, 0.0485, 0.0515]
MOUNT_DEG = [4.0, -3.0, 25.0]
LATENCY_S = 0.06


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=False)


def result(*arguments: object) -> dict[str, Any]:
    done = command(*arguments, "--json")
    assert done.returncode == 0, done.stderr
    printed: dict[str, Any] = json.loads(done.stdout)
    return printed


def rows(path: Path) -> list[list[str]]:
    with path.open() as file:
        return list(csv.reader(file))


def write(path: Path, table: list[list[str]]) -> None:
    path.write_text("".join(",".join(row) + "\n" for row in table))


def unit_from_robot(mount_deg: list[float]) -> list[list[float]]:
    """The transpose of Rz(yaw)·Ry(pitch)·Rx(roll)."""
    (sr, cr), (sp, cp), (sy, cy) = [(math.sin(a), math.cos(a)) for a in map(math.radians, mount_deg)]
    rotation = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return [list(column) for column in zip(*rotation, strict=True)]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive whose robot.toml is wrong about wheels, latency and mounting."""
    folder = tmp_path_factory.mktemp("drive")
    log, recording = folder / "drive.mcap", folder / "recording"
    scenario = ROOT / "config" / "scenarios" / "calibration_drive.toml"
    result("sim", scenario, "--record", log, "--images", "none")
    result("replay", log, "--export", recording)
    points = rows(recording / "points.csv")
    write(
        recording / "points.csv",
        [points[0]] + [[f"{float(stamp) + LATENCY_S:.6f}", x, y] for stamp, x, y in points[1:]],
    )
    turn = unit_from_robot(MOUNT_DEG)
    readings = rows(recording / "imu.csv")
    turned = [readings[0]]
    for row in readings[1:]:
        values = [float(value) for value in row]
        vectors = [[sum(a * b for a, b in zip(axis, values[k : k + 3], strict=True)) for axis in turn] for k in (1, 4)]
        turned.append([row[0], *(repr(value) for vector in vectors for value in vector)])
    write(recording / "imu.csv", turned)
    return recording


def errors(recording: Path) -> tuple[float, float]:
    """Median errors of position (metres) and heading (degrees)."""
    located = result("locate", recording)
    return located["position_error_m"]["median"], math.degrees(located["heading_error_rad"]["median"])


def include(recording: Path, *names: str) -> None:
    robot = recording / "robot.toml"
    text = [line for line in robot.read_text().splitlines() if not line.startswith("include")]
    robot.write_text("\n".join([f"include = {json.dumps(names)}", *text]) + "\n")


def test_calibrated_wheels_latency_and_unit_are_those_of_the_drive_and_the_poses_improve(drive: Path, tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    shutil.copytree(drive, recording)
    before = errors(recording)
    wheels = result("calibrate", "wheels", recording, "--out", recording / "wheels.toml")
    for radius, true in zip(wheels["wheel_radii_m"], RADII, strict=True):
        assert radius / true == pytest.approx(1.0, abs=0.02), wheels
    assert wheels["residual"][0] < 0.5 * wheels["residual_before"][0]
    include(recording, "wheels.toml")
    imu = result("calibrate", "imu", recording, "--out", recording / "imu.toml")
    for value, true, limit in zip(imu["mount_deg"], MOUNT_DEG, [0.4, 0.4, 1.5], strict=True):
        assert abs(value - true) < limit, imu
    include(recording, "wheels.toml", "imu.toml")
    latency = result("calibrate", "latency", recording, "--out", recording / "latency.toml")
    assert latency["camera_latency_s"] == pytest.approx(LATENCY_S, abs=0.003), latency
    assert latency["std_s"] < 0.003
    include(recording, "wheels.toml", "imu.toml", "latency.toml")
    after = errors(recording)
    assert after[0] < 0.4 * before[0] and after[0] < 0.015, (before, after)
    assert after[1] < 0.3 * before[1], (before, after)
    # Without the unit, the wheels tell the latency: their slip adds some milliseconds.
    (recording / "imu.csv").unlink()
    by_wheels = result("calibrate", "latency", recording, "--out", recording / "latency.toml")
    assert by_wheels["compared_with"] == "wheels"
    assert by_wheels["camera_latency_s"] == pytest.approx(LATENCY_S, abs=0.02), by_wheels


def test_drives_that_do_not_determine_a_quantity_are_refused_and_write_nothing(drive: Path, tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    shutil.copytree(drive, recording)
    # Only the part that stands, drives straight ahead and back.
    for name in ("points.csv", "odometry.csv", "imu.csv", "compass.csv"):
        table = rows(recording / name)
        write(recording / name, [table[0]] + [row for row in table[1:] if float(row[0]) < 12.0])
    for name, reason in [("wheels", "pieces of the drive"), ("latency", "")]:
        out = recording / f"{name}.toml"
        done = command("calibrate", name, recording, "--out", out)
        assert done.returncode == 1 and reason in done.stderr and not out.exists(), done.stderr
    table = rows(recording / "imu.csv")
    write(recording / "imu.csv", [table[0]] + [row for row in table[1:] if float(row[0]) > 4.5])
    done = command("calibrate", "imu", recording, "--out", recording / "imu.toml")
    assert done.returncode == 1 and "at rest" in done.stderr, done.stderr
    (recording / "odometry.csv").unlink()
    done = command("calibrate", "wheels", recording, "--out", recording / "wheels.toml")
    assert done.returncode == 1 and "no wheel motion" in done.stderr, done.stderr


def test_included_file_with_a_mistake_is_named_with_its_line(drive: Path, tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    shutil.copytree(drive, recording)
    include(recording, "wheels.toml")
    (recording / "wheels.toml").write_text("[odometry]\nmatrix = [[9.0, 0, 0], [0, 1, 0], [0, 0, 1]]\n")
    done = command("locate", recording)
    assert done.returncode == 1 and "wheels.toml" in done.stderr and "line 2" in done.stderr, done.stderr
