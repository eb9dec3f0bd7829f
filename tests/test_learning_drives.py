"""Are the poses of a robot right, and as certain as they say, while it learns its mount and its wheels?"""

import csv
import math
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target/release/mirrorball"


def mirrorball(*arguments: str | Path) -> None:
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


ASLANT = """robot = "{robots}/{robot}.toml"
field = "{fields}/msl_18x12.toml"
seed = 5
duration = 6.0
frame_rate_hz = 10.0
start = {{ x = -6.0, y = -2.0, theta_deg = 20.0 }}
[mount]
mirror_tilt_deg = [-0.561, -0.828]
mirror_offset = [0.00197, -0.00033]
[path]
speed = 1.5
turn_rate_deg = 70.0
waypoints = [{{ x = -2.0, y = -3.5, theta_deg = 60.0 }}, {{ x = 3.0, y = -3.0, theta_deg = 150.0 }}]
[others]
opponents = 5
mates = 3
"""


def errors_of(out: Path, truth_file: Path) -> list[tuple[float, float]]:
    """Error and standard deviation of the position of each image, metres."""
    truth = {row["stamp_s"]: row for row in rows(truth_file)}
    errors = []
    for row in rows(out):
        true = truth[row["stamp_s"]]
        dx, dy = (float(row[f"{axis}_m"]) - float(true[f"{axis}_m"]) for axis in "xy")
        errors.append((math.hypot(dx, dy), math.hypot(float(row["std_x_m"]), float(row["std_y_m"]))))
    return errors


@pytest.mark.parametrize("robot", ["hyperbolic", "default"])
def test_start_with_a_mirror_aslant_finds_no_other_place(tmp_path: Path, robot: str) -> None:
    config = ROOT / "config"
    scenario, out, log = tmp_path / "aslant.toml", tmp_path / "poses.csv", tmp_path / "drive.mcap"
    scenario.write_text(ASLANT.format(robots=config / "robots", robot=robot, fields=config / "fields"))
    mirrorball("sim", scenario, "--out", out, "--record", log, "--images", "none")
    mirrorball("replay", log, "--export", tmp_path / "drive")
    errors = errors_of(out, tmp_path / "drive" / "truth.csv")
    assert len(errors) > 50
    wrong = [each for each in errors if each[0] > max(0.15, 3.0 * each[1])]
    assert not wrong, wrong
    assert max(error for error, _ in errors[20:]) < 0.15


CREEPING = """\
robot = "{config}/robots/default.toml"
field = "{config}/fields/msl_18x12.toml"
seed = 43
duration = 12.0
frame_rate_hz = 20.0
start = {{ x = 1.0, y = -2.0, theta_deg = 70.0 }}
[path]
speed = 1.5
turn_rate_deg = 60.0
commands = [{{ time = 0.5, vx = {vx}, vy = {vy}, turn_deg = {turn} }}]
[[faults]]
kind = "wheel_stuck"
start = 0.0
stop = 12.0
wheel = {wheel}
"""


@pytest.mark.parametrize(
    ("wheel", "vx", "vy", "turn"), [(2, 0.05, 0.03, 3.0), (0, 0.05, 0.03, 3.0), (0, 0.1, 0.05, 0.0), (2, 0.05, 0.0, 0.0)]
)
def test_dead_encoder_of_a_creeping_robot_does_not_pull_the_pose_off_the_markings(
    tmp_path: Path, wheel: int, vx: float, vy: float, turn: float
) -> None:
    # Its images hardly move by the wheels, so their errors count as repeated, and a slow error of the wheels weighs more.
    scenario, out, truth = tmp_path / "creeping.toml", tmp_path / "poses.csv", tmp_path / "truth.csv"
    scenario.write_text(CREEPING.format(config=ROOT / "config", wheel=wheel, vx=vx, vy=vy, turn=turn))
    mirrorball("sim", scenario, "--out", out, "--truth", truth)
    errors = errors_of(out, truth)
    assert len(errors) > 200
    assert max(error for error, _ in errors) < 0.08
    assert all(error < 3.0 * std for error, std in errors)


SHIFTED = """\
robot = "robot.toml"
field = "{fields}/msl_18x12.toml"
seed = 1
duration = 15.0
frame_rate_hz = 10.0
start = {{ x = 2.0, y = -1.0, theta_deg = 40.0 }}
[mount]
mirror_tilt_deg = [0.026, -0.212]
mirror_offset = [-0.00047, -0.00174]
[path]
speed = 1.2
turn_rate_deg = 50.0
waypoints = [
  {{ x = -4.0, y = 3.0, theta_deg = -120.0 }},
  {{ x = 0.0, y = -4.0, theta_deg = 30.0 }},
  {{ x = 5.0, y = 2.0, theta_deg = 170.0 }},
]
[wheels]
radius_scale = [1.01, 1.0, 0.98]
"""


def test_wheels_tell_the_shift_of_all_points_that_images_do_not(tmp_path: Path) -> None:
    config = ROOT / "config"
    robot = (config / "robots" / "default.toml").read_text().replace("isometric_2001.csv", "isometric.csv")
    (tmp_path / "robot.toml").write_text(robot.replace('"../', f'"{config}/'))
    scenario, out, log = tmp_path / "shifted.toml", tmp_path / "poses.csv", tmp_path / "drive.mcap"
    scenario.write_text(SHIFTED.format(fields=config / "fields"))
    mirrorball("sim", scenario, "--out", out, "--record", log, "--images", "none")
    mirrorball("replay", log, "--export", tmp_path / "drive")
    errors = errors_of(out, tmp_path / "drive" / "truth.csv")
    assert len(errors) > 140
    assert all(error < 3.0 * std for error, std in errors[20:]), errors
    # Images alone leave the poses 5 to 10 cm beside the centre.
    assert max(error for error, _ in errors[70:]) < 0.035, errors[70:]
