"""Wrong set-ups are named, right ones are not doubted."""

import csv
import json
import math
import random
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from setup_mistakes import MISTAKES, make_folder, move_centre, scale_column

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target/release/mirrorball"
RIGHT = ROOT / "samples/sequence"
# Photographs that are not part of the repository are tried where they are.
PHOTOGRAPHS = ROOT.parent / "shared/real"

# What a warning and the doctor's edit must contain.
EDITS = {
    "small_field": "msl_18x12.toml",
    "narrow_field": "width = 12",
    "not_flipped": "flipped = true",
    "forward_right": "forward_deg = 90",
    "compass_degrees": "compass.csv: convert heading_rad from degrees",
    "stamps_milliseconds": "frames.csv: convert stamp_s from milliseconds",
    "turns_degrees": "odometry.csv: convert dtheta_rad from degrees",
    "centre_off": "centre_px = [2",
    "centre_far_off": "centre_px = [23",
    "camera_raised": "robot.toml: height = 0.60",
    "camera_raised_far": "robot.toml: height = 0.60",
    "forward_slightly_off": "robot.toml: forward_deg = ",
    "forward_off": "robot.toml: forward_deg = ",
    "path_centimetres": "odometry.csv: convert dx_m and dy_m from centimetres",
    "axes_exchanged": "odometry.csv: exchange dx_m and dy_m",
    "right_positive": "odometry.csv: change the sign of dy_m",
    "turns_clockwise": "odometry.csv: change the sign of dtheta_rad",
    "odometry_turned": "odometry.csv: change the sign of dx_m and dy_m",
    "wheels_half": "robot.toml: [odometry] matrix = [[",
    "wheels_twice": "robot.toml: [odometry] matrix = [[",
    "compass_clockwise": "compass.csv: change the sign of heading_rad",
}

# Lines of a gym, drawn one by one.
GYM = """
length = 11.0
width = 7.0
measured_to = "centres"
line_width = 0.05
border = 1.5
boundary = false
halfway_line = false
extra_lines = [
  [-5.5, -3.5, 5.5, -3.5],
  [-5.5, 3.5, 5.5, 3.5],
  [-5.5, -3.5, -5.5, 3.5],
  [5.5, -3.5, 5.5, 3.5],
  [0.0, -3.5, 0.0, 3.5],
  [-5.5, -1.5, -4.0, -1.5],
  [-5.5, 1.5, -4.0, 1.5],
  [-4.0, -1.5, -4.0, 1.5],
  [3.0, -2.0, 5.5, -2.0],
  [3.0, 2.0, 5.5, 2.0],
  [3.0, -2.0, 3.0, 2.0],
]
extra_arcs = [[0.0, 0.0, 1.2, 0.0, 360.0]]
"""

SHORT_FIELD = """
length = 9.0
width = 6.0
measured_to = "centres"
line_width = 0.05
border = 0.7
centre_circle_radius = 0.75
spot_radius = 0.05
penalty_spot = 1.3
goal_area = { depth = 0.6, width = 2.2 }
penalty_area = { depth = 1.65, width = 4.0 }
"""
SHORT_FIELD_DRIVE = """
robot = "robots/default.toml"
field = "fields/msl_18x12.toml"
seed = 3
duration = 20.0
frame_rate_hz = 10.0
start = { x = -2.7, y = -1.2, theta_deg = 20.0 }
[path]
speed = 1.0
turn_rate_deg = 60.0
repeat = true
waypoints = [
  { x = 0.45, y = -1.8, theta_deg = 60.0 },
  { x = 3.15, y = -1.5, theta_deg = 150.0 },
  { x = 2.7, y = 1.8, theta_deg = 240.0 },
  { x = -2.25, y = 1.8, theta_deg = 330.0 },
  { x = -3.15, y = -1.5, theta_deg = -90.0 },
]
[ball]
present = false
[people]
count = 0
"""


def run(*arguments: str | Path) -> tuple[dict[str, Any], str]:
    """The JSON result and what went to standard error. The doctor exits with 1 if it warns or compares nothing."""
    command = [str(PROGRAM), *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    result = json.loads(done.stdout) if done.stdout else {}
    is_ill = arguments[0] == "doctor" and (bool(result["warnings"]) or result["figures"] is None)
    assert done.returncode == int(is_ill), done.stderr
    return result, done.stderr


def poses(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_right_recording_has_no_warning_and_no_suggestion(tmp_path: Path) -> None:
    result, errors = run("locate", RIGHT, "--out", tmp_path / "poses.csv")
    assert result["warnings"] == [] and "warning" not in errors
    assert result["setup"]["on_markings"] > 0.95 and result["tracking"] >= 18
    found, _ = run("doctor", "--recording", RIGHT)
    assert found["suggestions"] == [] and found["warnings"] == []


def test_poses_have_the_fit_in_columns_at_the_end(tmp_path: Path) -> None:
    run("locate", RIGHT, "--out", tmp_path / "poses.csv")
    rows = poses(tmp_path / "poses.csv")
    assert list(rows[0])[9:] == ["reason", "on_markings", "residual_m", "markings_seen", "wheels_agree", "compass_agrees"]
    assert float(rows[-1]["on_markings"]) > 0.9 and float(rows[-1]["markings_seen"]) > 0.7
    assert float(rows[-1]["residual_m"]) < 0.05


def test_every_mistake_has_an_expected_edit() -> None:
    assert EDITS.keys() == MISTAKES.keys()


@pytest.mark.parametrize("mistake", list(MISTAKES))
def test_locate_warns_of_a_mistake_and_no_pose_is_confidently_wrong(mistake: str, tmp_path: Path) -> None:
    folder = make_folder(RIGHT, mistake, tmp_path / mistake)
    result, errors = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert any(EDITS[mistake] in warning for warning in result["warnings"]), result["warnings"]
    assert EDITS[mistake] in errors
    rows = [row for row in poses(tmp_path / "poses.csv") if row["x_m"]]
    # A centre that is a little off is such a mount as localization learns.
    if mistake in {"small_field", "narrow_field", "not_flipped", "forward_right", "centre_far_off"}:
        assert not any(row["mode"] == "tracking" for row in rows)
        assert all(row["reason"] == "doubtful set-up" for row in rows)
        assert all(max(float(row["std_x_m"]), float(row["std_y_m"])) > 0.05 for row in rows)
    elif mistake == "turns_degrees":
        # Without the table in the wrong unit the poses are right. Without a compass the half is unknown.
        assert result["position_error_m"]["max"] < 0.1


@pytest.mark.parametrize("mistake", ["small_field"])
def test_doctor_names_the_edit_first(mistake: str, tmp_path: Path) -> None:
    folder = make_folder(RIGHT, mistake, tmp_path / mistake)
    found, _ = run("doctor", "--recording", folder)
    first = found["suggestions"][0]
    assert EDITS[mistake] in first["change"], found["suggestions"]
    # The shipped field is measured to the lines' outer edges, the recorded one to their centres: an eighth of a metre.
    assert first["fit_after"] > 0.8 > first["fit_before"] + 0.2


@pytest.mark.parametrize("mistake", ["forward_slightly_off", "forward_off"])
def test_angle_of_the_camera_is_named_within_two_degrees(mistake: str, tmp_path: Path) -> None:
    folder = make_folder(RIGHT, mistake, tmp_path / mistake)
    found, _ = run("doctor", "--recording", folder)
    named = re.search(r"forward_deg = ([\d.]+)", found["suggestions"][0]["change"])
    assert named is not None and abs(float(named[1]) - 90.0) < 2.0, found["suggestions"]
    assert found["figures"]["wheels_agree"] < 0.995


def test_wheels_that_report_no_motion_are_named(tmp_path: Path) -> None:
    folder = tmp_path / "still"
    shutil.copytree(RIGHT, folder)
    for column in ("dx_m", "dy_m", "dtheta_rad"):
        scale_column(folder / "odometry.csv", column, 0.0)
    found, _ = run("doctor", "--recording", folder)
    assert any("the wheels report no motion" in warning for warning in found["warnings"]), found["warnings"]


def test_compass_that_repeats_one_value_while_the_robot_turns_is_named_and_left_out(tmp_path: Path) -> None:
    folder = tmp_path / "dead"
    shutil.copytree(RIGHT, folder)
    header, *rows = (folder / "compass.csv").read_text().splitlines()
    dead = [f"{row.split(',')[0]},0.7" for row in rows]
    (folder / "compass.csv").write_text("\n".join([header, *dead]) + "\n")
    result, _ = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert any("every reading is 0.700" in warning for warning in result["warnings"]), result["warnings"]
    (folder / "compass.csv").unlink()
    without, _ = run("locate", folder, "--out", tmp_path / "without.csv")
    assert without["warnings"] == []
    assert (tmp_path / "poses.csv").read_text() == (tmp_path / "without.csv").read_text()


@pytest.fixture(scope="module")
def demo_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive of the demo's robot, with an inertial unit, on a field that looks the same after half a turn."""
    work = tmp_path_factory.mktemp("demo")
    run("sim", ROOT / "config/scenarios/demo.toml", "--duration", "15", "--record", work / "drive.mcap")
    run("replay", work / "drive.mcap", "--export", work / "drive")
    return work / "drive"


def copy_with_later_stamps(drive: Path, table: str, seconds: float, folder: Path) -> Path:
    """A copy of the drive with a table whose stamps are late."""
    copy_of(drive, folder)
    header, *rows = (folder / table).read_text().splitlines()
    cells = [row.split(",") for row in rows]
    stamp = header.split(",").index("stamp_s")
    for row in cells:
        row[stamp] = f"{float(row[stamp]) + seconds:.9f}"
    (folder / table).write_text("\n".join([header, *map(",".join, cells)]) + "\n")
    return folder


@pytest.mark.parametrize("late", [0.08, 0.4])
def test_images_that_are_older_than_their_stamps_are_named(demo_drive: Path, late: float, tmp_path: Path) -> None:
    right, _ = run("doctor", "--recording", demo_drive)
    assert right["warnings"] == []
    folder = copy_with_later_stamps(demo_drive, "frames.csv", late, tmp_path / "drive")
    found, _ = run("doctor", "--recording", folder)
    (named,) = [match for warning in found["warnings"] if (match := re.search(r"camera_latency = ([\d.]+)", warning))]
    assert abs(float(named[1]) - late) < 0.015, found["warnings"]
    robot = folder / "robot.toml"
    robot.write_text(robot.read_text() + f"\n[timing]\ncamera_latency = {late}\n")
    stated, _ = run("doctor", "--recording", folder)
    assert not any("stamps" in warning for warning in stated["warnings"]), stated["warnings"]
    poses, _ = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert poses["tracking"] > 0.95 * poses["frames"]


@pytest.mark.parametrize("length", [17.6, 18.5])
def test_mount_that_may_be_learned_does_not_hide_a_field_of_another_length(
    demo_drive: Path, length: float, tmp_path: Path
) -> None:
    folder = copy_of(demo_drive, tmp_path / "drive")
    field = folder / "field.toml"
    text, count = re.subn(r"(?m)^length = 18\.0$", f"length = {length}", field.read_text())
    assert count == 1
    field.write_text(text)
    found, _ = run("doctor", "--recording", folder)
    named = re.search(r"length = ([\d.]+)", "\n".join(found["warnings"]))
    assert named is not None and abs(float(named[1]) - 18.0) < 0.06, found["warnings"]


@pytest.mark.parametrize("late", [0.05, 0.1, 0.2, 0.5])
def test_wheels_whose_stamps_are_late_are_named(demo_drive: Path, late: float, tmp_path: Path) -> None:
    folder = copy_with_later_stamps(demo_drive, "odometry.csv", late, tmp_path / "drive")
    result, _ = run("locate", folder, "--out", tmp_path / "poses.csv")
    named = [re.search(r"odometry.csv: subtract ([\d.]+) from stamp_s", warning) for warning in result["warnings"]]
    # Half a second late, the first images have no wheels, which is said, too.
    begins = [warning for warning in result["warnings"] if "odometry.csv begins" in warning]
    assert len(named) == 1 + len(begins), result["warnings"]
    assert any(found is not None and abs(float(found[1]) - late) < 0.2 * late for found in named), result["warnings"]


@pytest.mark.parametrize("mistake", ["wheels_half", "wheels_twice"])
def test_matrix_that_is_named_mends_wheels_of_another_size(demo_drive: Path, mistake: str, tmp_path: Path) -> None:
    folder = copy_of(demo_drive, tmp_path / "drive")
    MISTAKES[mistake](folder)
    found, _ = run("doctor", "--recording", folder)
    (warning,) = found["warnings"]
    named = re.search(r"robot.toml: \[odometry\] (matrix = .*\]\]) \(\+- 0\.0", warning)
    assert named is not None, warning
    robot = folder / "robot.toml"
    robot.write_text(f"{robot.read_text()}\n[odometry]\n{named[1]}\n")
    mended, _ = run("doctor", "--recording", folder)
    assert mended["warnings"] == []


def test_inertial_unit_tells_a_turned_odometry_from_a_turned_camera(demo_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(demo_drive, tmp_path / "drive")
    MISTAKES["odometry_turned"](folder)
    found, _ = run("doctor", "--recording", folder)
    (warning,) = found["warnings"]
    assert warning.startswith("the odometry is turned by 180 degrees"), warning
    assert "forward direction" in found["suggestions"][1]["cause"]
    (folder / "imu.csv").unlink()
    found, _ = run("doctor", "--recording", folder)
    (warning,) = found["warnings"]
    assert "forward direction" in warning and "or else the odometry is turned by 180 degrees" in warning, warning


def test_points_that_no_set_up_explains_are_doubted(tmp_path: Path) -> None:
    folder = tmp_path / "random"
    folder.mkdir()
    shutil.copy(RIGHT / "field.toml", folder)
    (folder / "robot.toml").write_text('field = "field.toml"\n')
    # Points all over the ground lie on no field's markings.
    chance = random.Random(4)
    rows = [
        f"{0.2 * image:.1f},{chance.uniform(-5.0, 5.0):.3f},{chance.uniform(-5.0, 5.0):.3f}"
        for image in range(12)
        for _ in range(150)
    ]
    (folder / "points.csv").write_text("\n".join(["stamp_s,x_m,y_m", *rows]) + "\n")
    found, _ = run("doctor", "--recording", folder)
    assert len(found["doubts"]) == 1 and "% o" in found["doubts"][0], found["warnings"]


def test_wrong_wheels_are_not_taken_for_turns_in_degrees(tmp_path: Path) -> None:
    wheels = "wheels.radius_scale=[1.3, 0.8, 1.2]"
    result, _ = run("sim", ROOT / "config/scenarios/demo.toml", "--duration", "12", "--set", wheels)
    warnings = " | ".join(result["warnings"])
    assert "[odometry] matrix" in warnings and "57.29" not in warnings, warnings


def test_two_mistakes_are_both_named(tmp_path: Path) -> None:
    folder = make_folder(RIGHT, "narrow_field", tmp_path / "both")
    MISTAKES["not_flipped"](folder)
    found, _ = run("doctor", "--recording", folder)
    changes = " | ".join(one["change"] for one in found["suggestions"])
    assert "width = 12" in changes and "flipped = true" in changes


def five_images(folder: Path) -> Path:
    """Every fourth image of the sample, without wheels: each is located by itself."""
    shutil.copytree(RIGHT, folder)
    (folder / "odometry.csv").unlink()
    lines = (folder / "frames.csv").read_text().splitlines()
    (folder / "frames.csv").write_text("\n".join(lines[:1] + lines[1::4]) + "\n")
    return folder


@pytest.mark.parametrize("photographs", ["sample", *([] if not PHOTOGRAPHS.is_dir() else ["half_field_2017"])])
def test_headings_in_degrees_are_named_for_a_handful_of_images(photographs: str, tmp_path: Path) -> None:
    # Five images: four of the wrong headings agree with one of their poses by chance.
    right = five_images(tmp_path / "right") if photographs == "sample" else PHOTOGRAPHS / photographs
    folder = make_folder(right, "compass_degrees", tmp_path / "few")
    result, _ = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert any(EDITS["compass_degrees"] in warning for warning in result["warnings"]), result["warnings"]


def test_centre_that_only_the_rim_tells_is_named(tmp_path: Path) -> None:
    folder = five_images(tmp_path / "few")
    move_centre(folder, -4.0, 3.0)
    result, _ = run("doctor", "--recording", folder)
    edit = re.search(r"centre_px = \[([\d.]+), ([\d.]+)\]", result["suggestions"][0]["change"])
    assert edit is not None, result["suggestions"]
    assert abs(float(edit[1]) - 238.9) < 0.3 and abs(float(edit[2]) - 241.3) < 0.3, edit[0]
    assert_not_confidently_wrong(folder, tmp_path / "poses.csv")


def drive_on_a_larger_field(folder: Path) -> Path:
    """A simulated drive on a field of which every size differs a little from the 12 x 8 m one."""
    sizes = {"length": "12.35", "width": "8.45", "centre_circle_radius": "1.4", "penalty_spot": "2.05"}
    field = (ROOT / "config/fields/msl_12x8.toml").read_text()
    for key, value in sizes.items():
        field = re.sub(rf"(?m)^{key} = [\d.]+", f"{key} = {value}", field)
    field = field.replace("penalty_area = { depth = 1.5, width = 5.0 }", "penalty_area = { depth = 1.6, width = 4.4 }")
    work = folder.parent
    (work / "larger.toml").write_text(field)
    (work / "scenario.toml").write_text(
        f"""robot = "{ROOT}/config/robots/default.toml"
field = "larger.toml"
duration = 12.0
start = {{ x = -4.0, y = -2.0, theta_deg = 0.0 }}
[path]
speed = 1.2
waypoints = [{{ x = 3.0, y = -2.0 }}, {{ x = 4.0, y = 2.0 }}, {{ x = -4.0, y = 2.0 }}]
"""
    )
    run("sim", work / "scenario.toml", "--record", work / "drive.mcap")
    run("replay", work / "drive.mcap", "--export", folder)
    return folder


@pytest.mark.parametrize("recording", ["simulation", *([] if not PHOTOGRAPHS.is_dir() else ["lab_2016"])])
def test_field_of_another_kind_is_named_by_its_sizes(recording: str, tmp_path: Path) -> None:
    folder = tmp_path / "lab"
    if recording == "simulation":
        drive_on_a_larger_field(folder)
    else:
        shutil.copytree(PHOTOGRAPHS / recording, folder)
    right, _ = run("doctor", "--recording", folder)
    assert right["suggestions"] == []
    shutil.copy(ROOT / "config/fields/msl_12x8.toml", folder / "field.toml")
    result, _ = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert any("width = 8." in warning for warning in result["warnings"]), result["warnings"]
    rows = poses(tmp_path / "poses.csv")
    assert all(row["reason"] == "doubtful set-up" for row in rows)
    truth = {row["stamp_s"]: row for row in poses(folder / "truth.csv")}
    for row in rows:
        for axis in "xy":
            error = abs(float(row[f"{axis}_m"]) - float(truth[row["stamp_s"]][f"{axis}_m"]))
            assert error < 3.0 * float(row[f"std_{axis}_m"])


@pytest.fixture(scope="module")
def gym_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive in a gym whose lines are drawn, under a mirror that shows distances evenly: a shift of its image looks like
    one of the robot."""
    work = tmp_path_factory.mktemp("gym")
    for part in ("fields", "mirrors", "robots"):
        shutil.copytree(ROOT / "config" / part, work / part)
    robot = (work / "robots/default.toml").read_text().replace("isometric_2001.csv", "isometric.csv")
    (work / "robots/gym.toml").write_text(robot.replace("msl_18x12.toml", "gym.toml"))
    (work / "fields/gym.toml").write_text(GYM)
    (work / "gym_drive.toml").write_text(
        'robot = "robots/gym.toml"\nfield = "fields/gym.toml"\nseed = 5\nduration = 20.0\nframe_rate_hz = 10.0\n'
        "start = { x = -3.5, y = 0.0, theta_deg = 0.0 }\n"
        "[path]\nspeed = 1.5\nturn_rate_deg = 90.0\nwaypoints = [\n"
        "  { x = 1.0, y = 2.5, theta_deg = -80.0 },\n  { x = 4.0, y = -1.0, theta_deg = 170.0 },\n"
        "  { x = 0.0, y = -2.5, theta_deg = 60.0 },\n  { x = -3.0, y = 2.0, theta_deg = -90.0 },\n]\n"
        "[ball]\nposition = [0.5, -0.4]\n"
        "[wheels]\nradius_scale = [1.03, 1.02, 1.04]\n"
    )
    run("sim", work / "gym_drive.toml", "--record", work / "drive.mcap")
    run("replay", work / "drive.mcap", "--export", work / "drive")
    robot_file = work / "drive/robot.toml"
    robot_file.write_text(robot_file.read_text().replace('[map]\nfile = "map.npz"\n', ""))
    return work / "drive"


def copy_of(drive: Path, folder: Path) -> Path:
    shutil.copytree(drive, folder)
    return folder


def assert_not_confidently_wrong(folder: Path, out: Path) -> list[str]:
    """Locates a drive and returns the warnings. Half turns of the field count as right."""
    result, _ = run("locate", folder, "--out", out)
    truth = {row["stamp_s"]: row for row in poses(folder / "truth.csv")}
    for row in poses(out):
        if row["mode"] == "lost":
            continue
        true = truth[row["stamp_s"]]
        for axis in "xy":
            found, right = float(row[f"{axis}_m"]), float(true[f"{axis}_m"])
            error = min(abs(found - right), abs(found + right))
            assert error < 3.5 * float(row[f"std_{axis}_m"]), row
        turn = float(row["theta_rad"]) - float(true["theta_rad"])
        assert abs(math.sin(turn)) < 3.5 * float(row["std_theta_rad"]), row
    warnings: list[str] = result["warnings"]
    return warnings


def test_drive_on_drawn_lines_has_no_suggestion(gym_drive: Path) -> None:
    result, _ = run("doctor", "--recording", gym_drive)
    assert result["suggestions"] == [] and result["warnings"] == []


def test_drawn_lines_in_the_wrong_place_are_named(gym_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    (folder / "field.toml").write_text(GYM.replace("3.5", "4.0").replace("width = 7.0", "width = 8.0"))
    result, _ = run("doctor", "--recording", folder)
    assert "extra_lines: y = ±3.5" in result["suggestions"][0]["change"], result["suggestions"]
    warnings = assert_not_confidently_wrong(folder, tmp_path / "poses.csv")
    assert any("y = ±3.5" in warning for warning in warnings), warnings


def test_centre_that_only_the_wheels_tell_is_named(gym_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    move_centre(folder, 4.0, -3.0)
    result, _ = run("doctor", "--recording", folder)
    edit = re.search(r"centre_px = \[([\d.]+), ([\d.]+)\]", result["suggestions"][0]["change"])
    assert edit is not None, result["suggestions"]
    assert abs(float(edit[1]) - 239.3) < 0.7 and abs(float(edit[2]) - 240.6) < 0.7
    warnings = assert_not_confidently_wrong(folder, tmp_path / "poses.csv")
    assert any("centre_px" in warning for warning in warnings), warnings


@pytest.fixture(scope="module")
def short_field_drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive on a field on which a tilted mount explains the line points of a wrong centre nearly as well."""
    work = tmp_path_factory.mktemp("short")
    for part in ("mirrors", "robots"):
        shutil.copytree(ROOT / "config" / part, work / part)
    (work / "fields").mkdir()
    (work / "fields/msl_18x12.toml").write_text(SHORT_FIELD)
    (work / "drive.toml").write_text(SHORT_FIELD_DRIVE)
    run("sim", work / "drive.toml", "--record", work / "drive.mcap")
    run("replay", work / "drive.mcap", "--export", work / "drive")
    robot = work / "drive/robot.toml"
    robot.write_text(robot.read_text().replace('[map]\nfile = "map.npz"\n', ""))
    return work / "drive"


@pytest.mark.parametrize("shift", [(-17.3, 14.4), (0.0, 21.4), (16.7, -14.6)])
def test_centre_that_a_learned_mount_would_hide_is_named(
    short_field_drive: Path, shift: tuple[float, float], tmp_path: Path
) -> None:
    folder = copy_of(short_field_drive, tmp_path / "drive")
    move_centre(folder, *shift)
    warnings = assert_not_confidently_wrong(folder, tmp_path / "poses.csv")
    assert "centre_px = [239" in warnings[0] and not any("radii" in warning for warning in warnings), warnings
    assert all(row["reason"] == "doubtful set-up" for row in poses(tmp_path / "poses.csv"))


def test_wheels_that_turn_about_another_point_are_not_taken_for_a_wrong_centre(gym_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    table = folder / "odometry.csv"
    rows = poses(table)
    for row in rows:
        row["dy_m"] = str(float(row["dy_m"]) + 0.1 * float(row["dtheta_rad"]))
    with table.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    result, _ = run("doctor", "--recording", folder)
    assert not any("centre_px" in found["change"] for found in result["suggestions"]), result["suggestions"]
    assert any("turn about" in warning or "odometry" in warning for warning in result["warnings"]), result["warnings"]


@pytest.mark.parametrize("unit, per_metre", [("millimetres", 1000.0), ("inches", 39.37), ("feet", 3.281)])
def test_unit_of_the_path_is_named(gym_drive: Path, unit: str, per_metre: float, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    for column in ("dx_m", "dy_m"):
        scale_column(folder / "odometry.csv", column, per_metre)
    result, _ = run("doctor", "--recording", folder)
    edit = f"odometry.csv: convert dx_m and dy_m from {unit}"
    assert edit in result["suggestions"][0]["change"], result["suggestions"]
    # The inertial unit contradicts these wheels, and is right.
    assert len(result["warnings"]) == 1, result["warnings"]


def test_wrong_radius_of_a_drawn_circle_is_named(gym_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    (folder / "field.toml").write_text(GYM.replace("0.0, 0.0, 1.2,", "0.0, 0.0, 1.5,"))
    result, _ = run("doctor", "--recording", folder)
    assert "extra_arcs: radius = 1.2" in result["suggestions"][0]["change"], result["suggestions"]


def test_lines_that_are_missing_from_the_drawing_are_doubted(gym_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    drawn = GYM.splitlines()
    (folder / "field.toml").write_text("\n".join(line for line in drawn if "-5.5, " not in line and "arcs" not in line))
    warnings = assert_not_confidently_wrong(folder, tmp_path / "poses.csv")
    assert warnings


def test_wheels_that_measure_one_direction_too_long_are_named(gym_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    scale_column(folder / "odometry.csv", "dx_m", 1.12)
    result, _ = run("doctor", "--recording", folder)
    matrix = re.search(r"matrix = \[\[([-\d.]+)", result["suggestions"][0]["change"])
    # The wheels' own radii are 3 % larger than stated.
    assert matrix is not None and abs(float(matrix[1]) - 1.03 / 1.12) < 0.03, result["suggestions"]


def deviations_of(folder: Path, out: Path) -> list[float]:
    """Locates a drive: errors of all poses with a mode and without a reason, in standard deviations of their worst axis."""
    run("locate", folder, "--out", out)
    truth = {row["stamp_s"]: row for row in poses(folder / "truth.csv")}
    deviations = []
    for row in poses(out):
        if row["mode"] == "lost" or row["reason"]:
            continue
        true = truth[row["stamp_s"]]
        position = max(
            min(abs(float(row[f"{axis}_m"]) - sign * float(true[f"{axis}_m"])) for sign in (1.0, -1.0))
            / float(row[f"std_{axis}_m"])
            for axis in "xy"
        )
        turn = abs(math.sin(float(row["theta_rad"]) - float(true["theta_rad"])))
        deviations.append(max(position, turn / float(row["std_theta_rad"])))
    return deviations


def test_mount_of_an_uncalibrated_camera_is_told_by_the_images_of_the_drive(tmp_path: Path) -> None:
    # Each within the standard deviation that localization expects of a mount, or nearly.
    mount = {"mirror_tilt_deg": "[0.13, -0.21]", "mirror_offset": "[0.0007, -0.0009]", "lean_deg": "[-0.12, -0.51]"}
    settings = [argument for key, value in mount.items() for argument in ("--set", f"mount.{key}={value}")]
    scenario = ROOT / "config/scenarios/demo.toml"
    run("sim", scenario, "--seed", "5", "--duration", "20", *settings, "--record", tmp_path / "drive.mcap")
    run("replay", tmp_path / "drive.mcap", "--export", tmp_path / "drive")
    found, _ = run("doctor", "--recording", tmp_path / "drive")
    assert found["warnings"] == [] and found["figures"]["mount_learned"] and found["figures"]["on_markings"] > 0.9
    result, _ = run("locate", tmp_path / "drive", "--out", tmp_path / "poses.csv")
    assert result["warnings"] == [] and result["position_error_m"]["max"] < 0.06
    deviations = deviations_of(tmp_path / "drive", tmp_path / "poses.csv")
    assert len(deviations) > 500 and sum(value > 3.0 for value in deviations) < 0.02 * len(deviations)


@pytest.mark.parametrize("without", [("odometry.csv",), ("odometry.csv", "imu.csv")])
def test_mount_that_no_wheels_can_teach_is_in_the_uncertainty_of_the_poses(
    gym_drive: Path, tmp_path: Path, without: tuple[str, ...]
) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    for name in without:
        (folder / name).unlink()
    # Less than the check of a set-up names without wheels.
    move_centre(folder, 1.2, -0.9)
    deviations = deviations_of(folder, tmp_path / "poses.csv")
    assert len(deviations) > 150
    assert sum(value > 3.0 for value in deviations) <= 0.02 * len(deviations), deviations


def write_map(path: Path, x: NDArray[np.float32], y: NDArray[np.float32]) -> None:
    np.savez_compressed(path, x_m=x.astype(np.float32), y_m=y.astype(np.float32))


@pytest.mark.parametrize(("mirrored", "degrees"), [(False, 0.0), (False, 180.0), (True, 37.0), (False, -100.0)])
def test_side_forward_and_origin_of_a_map_are_found_by_the_wheels(
    gym_drive: Path, tmp_path: Path, mirrored: bool, degrees: float
) -> None:
    right = np.load(gym_drive / "map.npz")
    x, y = right["x_m"] - 0.06, right["y_m"] + 0.04
    sin, cos = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
    y = -y if mirrored else y
    write_map(tmp_path / "guessed.npz", cos * x + sin * y, cos * y - sin * x)
    result, _ = run("calibrate", "mount", gym_drive, "--map", tmp_path / "guessed.npz", "--out", tmp_path / "mounted.npz")
    assert result["mirrored"] == mirrored
    assert result["wheels_agree"] > 0.95
    assert result["turn_std_deg"] < 1.0 and result["origin_std_m"] < 0.03
    stated = {"origin_std": result["origin_std_m"], "turn_std_deg": result["turn_std_deg"]}
    folder = copy_of(gym_drive, tmp_path / "drive")
    lines = [f"{key} = {value}" for key, value in stated.items()]
    with (folder / "robot.toml").open("a") as file:
        file.write("\n".join(["", "[map]", f'file = "{tmp_path}/mounted.npz"', *lines, ""]))
    assert_not_confidently_wrong(folder, tmp_path / "poses.csv")
    mounted = np.load(tmp_path / "mounted.npz")
    near = np.hypot(right["x_m"], right["y_m"]) < 2.0
    off = [np.nanmedian(mounted[name][near] - right[name][near]) for name in ("x_m", "y_m")]
    assert np.hypot(*off) < 0.03, result
    turn = np.angle(np.nansum((mounted["x_m"] + 1j * mounted["y_m"])[near] * (right["x_m"] - 1j * right["y_m"])[near]))
    assert abs(math.degrees(turn)) < 1.5, result


def test_mount_of_a_map_needs_a_calibrated_map_and_wheels(gym_drive: Path, tmp_path: Path) -> None:
    folder = copy_of(gym_drive, tmp_path / "drive")
    (folder / "odometry.csv").unlink()
    profile = [str(RIGHT)]
    right = np.load(gym_drive / "map.npz")
    write_map(tmp_path / "guessed.npz", right["x_m"] - 0.06, right["y_m"])
    no_wheels = [str(folder), "--map", str(tmp_path / "guessed.npz")]
    for arguments, reason in [(profile, "mirror profile"), (no_wheels, "odometry.csv")]:
        out = tmp_path / "mounted.npz"
        command = [str(PROGRAM), "calibrate", "mount", *arguments, "--out", str(out)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert done.returncode == 1 and reason in done.stderr, done.stderr
        assert not out.exists()


def test_simulated_game_has_no_warning() -> None:
    scenario = ROOT / "config/scenarios/tracks_18x12.toml"
    result, _ = run("sim", scenario, "--duration", "6")
    assert result["warnings"] == []


def test_turned_compass_on_a_symmetric_field_has_two_edits_half_a_turn_apart(tmp_path: Path) -> None:
    for name, error in (("quarter", 90.0), ("sixth", 60.0)):
        folder = tmp_path / name
        shutil.copytree(RIGHT, folder)
        header, *rows = (folder / "compass.csv").read_text().splitlines()
        turned = []
        for row in rows:
            stamp, heading = row.split(",")
            turned.append(f"{stamp},{float(heading) + math.radians(error)}")
        (folder / "compass.csv").write_text("\n".join([header, *turned]) + "\n")
        found, _ = run("doctor", "--recording", folder)
        edits = [one for one in found["suggestions"] if "compass.csv: turn" in one["change"]]
        angles = sorted(int(re.search(r"by (\d+) degrees", one["change"])[1]) for one in edits)  # type: ignore[index]
        assert len(angles) == 2 and angles[1] - angles[0] == 180, found["suggestions"]
        assert all(one["half_unknown"] for one in edits)
        assert min(abs((angle + error + 180.0) % 360.0 - 180.0) for angle in angles) <= 15.0, angles
        assert not any("degrees to radians" in one["change"] for one in found["suggestions"])
        warning = next(text for text in found["warnings"] if "compass" in text)
        assert all(f"by {angle} degrees" in warning for angle in angles) and "on which half" in warning


def test_odometry_that_ends_early_is_named_by_locate(tmp_path: Path) -> None:
    folder = tmp_path / "cut"
    shutil.copytree(RIGHT, folder)
    lines = (folder / "odometry.csv").read_text().splitlines()
    (folder / "odometry.csv").write_text("\n".join(lines[:7]) + "\n")
    result, errors = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert any("odometry.csv ends at" in warning for warning in result["warnings"]), result["warnings"]
    assert "odometry.csv ends at" in errors
