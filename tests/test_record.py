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
    while len(list((tmp_path / "drive.part" / "frames").glob("*.png"))) < 40:
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
    assert images == sorted(images) and not (tmp_path / "drive.part").exists()
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
    assert not (tmp_path / "drive").exists() and not (tmp_path / "drive.part").exists()
