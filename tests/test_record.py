"""Does `mirrorball record` write what the devices measure, before anything is calibrated?"""

import csv
import json
import signal
import time
from pathlib import Path

from test_robot import ended, hardware, start


def test_recording_needs_no_calibration_and_can_be_calibrated(tmp_path: Path) -> None:
    robot, drive = tmp_path / "robot", tmp_path / "drive"
    sim = hardware(robot, "--own-path")
    # Neither map, mirror nor centre: the field and the image's size alone.
    section = {"width_px": 480, "height_px": 480}
    lines = [line for line in (robot / "robot.toml").read_text().splitlines() if line.startswith("field")]
    camera = "".join(f"{key} = {value}\n" for key, value in section.items())
    (robot / "robot.toml").write_text("\n".join(lines) + f"\n[camera]\n{camera}[base]\n")
    recording = start("record", "--robot", robot, "--out", drive, "--json")
    until = time.monotonic() + 60
    while len(list(tmp_path.glob("drive.*.part/frames/*.png"))) < 40:
        assert time.monotonic() < until and recording.poll() is None
        time.sleep(0.1)
    assert not drive.exists()
    recording.send_signal(signal.SIGTERM)
    report = ended(recording)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    assert report["frames"] >= 40 and report["odometry"] > 100 and report["imu"] > 100, report
    with (drive / "frames.csv").open() as file:
        images = [(float(row["stamp_s"]), row["file"]) for row in csv.DictReader(file)]
    assert len(images) == report["frames"] and all((drive / file).is_file() for _, file in images)
    assert images == sorted(images) and not list(tmp_path.glob("drive.*"))
    rim = ended(start("calibrate", "rim", drive, "--json"))
    assert abs(rim["outer_radius_px"] - 234.0) < 3.0, rim
    again = start("record", "--robot", robot, "--out", drive, "--json")
    _, message = again.communicate(timeout=60)
    assert again.returncode == 1 and "not an empty folder" in message
    assert json.dumps(report["out"]).strip('"') == str(drive)


def test_recording_without_a_camera_image_says_so_and_leaves_nothing(tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    sim = hardware(robot)
    sim.kill()
    sim.communicate()
    recording = start("record", "--robot", robot, "--out", tmp_path / "drive", "--duration", 1)
    _, message = recording.communicate(timeout=60)
    assert recording.returncode == 1 and "no image was recorded" in message, message
    assert not (tmp_path / "drive").exists() and not list(tmp_path.glob("drive.*"))


def exported(log: Path, folder: Path) -> int:
    """Exports a log; the number of images, each of which is there."""
    ended(start("replay", log, "--export", folder, "--json"))
    with (folder / "frames.csv").open() as file:
        images = [folder / row["file"] for row in csv.DictReader(file)]
    assert all(image.is_file() for image in images)
    return len(images)


def wait_for_size(path: Path, size: int) -> None:
    until = time.monotonic() + 60
    while not path.exists() or path.stat().st_size < size:
        assert time.monotonic() < until
        time.sleep(0.1)


def test_recorded_log_is_there_from_the_start_and_becomes_a_recording_folder(tmp_path: Path) -> None:
    robot, log = tmp_path / "robot", tmp_path / "drive.mcap"
    sim = hardware(robot, "--own-path")
    recording = start("record", "--robot", robot, "--out", log, "--json")
    wait_for_size(log, 4_000_000)
    recording.send_signal(signal.SIGTERM)
    report = ended(recording)
    assert report["files"] == [str(log)] and report["odometry"] > 10 and report["imu"] > 10, report
    assert exported(log, tmp_path / "drive") == report["frames"] > 10
    rim = ended(start("calibrate", "rim", tmp_path / "drive", "--json"))
    assert abs(rim["outer_radius_px"] - 234.0) < 3.0, rim
    # It holds no estimates, and is not called verified.
    verified = start("replay", log, "--verify")
    _, message = verified.communicate(timeout=60)
    assert verified.returncode == 1 and "--export" in message, message
    again = start("record", "--robot", robot, "--out", log)
    _, message = again.communicate(timeout=60)
    assert again.returncode == 1 and "exists" in message
    # A killed process leaves what was flushed.
    killed = start("record", "--robot", robot, "--out", tmp_path / "killed.mcap")
    wait_for_size(tmp_path / "killed.mcap", 4_000_000)
    killed.kill()
    killed.communicate()
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    ended(start("recover", tmp_path / "killed.mcap", "--out", tmp_path / "whole.mcap", "--json"))
    assert exported(tmp_path / "whole.mcap", tmp_path / "killed") > 10
    # Without an image nothing is left.
    empty = start("record", "--robot", robot, "--out", tmp_path / "empty.mcap", "--duration", 1)
    _, message = empty.communicate(timeout=60)
    assert empty.returncode == 1 and "no image was recorded" in message
    assert not (tmp_path / "empty.mcap").exists()
