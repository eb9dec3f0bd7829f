"""Recordings with bad images or a bad compass: the doctor and `locate` name what is wrong, and nothing else."""

import csv
import json
import math
import os
import random
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "target/release/mirrorball"
IMAGES = 200
"""Images of the drive, ten a second; the faults begin half way."""

Row = dict[str, str]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    work = tmp_path_factory.mktemp("drive")
    log, folder = work / "drive.mcap", work / "drive"
    scenario = ROOT / "config/scenarios/demo.toml"
    options = ["--duration", "20", "--seed", "6", "--set", "frame_rate_hz=10", "--record", str(log)]
    subprocess.run([str(PROGRAM), "sim", str(scenario), *options], check=True, capture_output=True)
    subprocess.run([PROGRAM, "replay", log, "--export", folder], check=True, capture_output=True)
    assert len(rows_of(folder / "frames.csv")) == IMAGES
    return folder


def rows_of(table: Path) -> list[Row]:
    with table.open() as file:
        return list(csv.DictReader(file))


def write_rows(table: Path, rows: list[Row]) -> None:
    with table.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def copy_of(drive: Path, folder: Path) -> Path:
    """A copy whose images are linked: a changed one is a new file."""
    shutil.copytree(drive, folder, copy_function=os.link)
    for file in folder.iterdir():
        if file.is_file():
            text = file.read_bytes()
            file.unlink()
            file.write_bytes(text)
    return folder


def refusal(folder: Path) -> str:
    done = subprocess.run([PROGRAM, "locate", folder], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr
    return done.stderr


def test_rows_of_odometry_written_twice_are_refused(drive: Path, tmp_path: Path) -> None:
    folder = copy_of(drive, tmp_path / "twice")
    rows = rows_of(folder / "odometry.csv")
    write_rows(folder / "odometry.csv", [row for row in rows for _ in range(2)])
    assert "odometry.csv: line" in refusal(folder) and "the row before again" in refusal(folder)
    # A row of a steady drive that repeats by its coarse stamp is none.
    write_rows(folder / "odometry.csv", [row for k, row in enumerate(rows) for _ in range(2 if k % 10 == 0 else 1)])
    subprocess.run([PROGRAM, "locate", folder], capture_output=True, check=True)


def test_images_that_share_their_times_are_refused(drive: Path, tmp_path: Path) -> None:
    folder = copy_of(drive, tmp_path / "one_time")
    rows = rows_of(folder / "frames.csv")
    write_rows(folder / "frames.csv", [{**row, "stamp_s": "0.5"} for row in rows])
    assert f"frames.csv: {IMAGES - 1} of {IMAGES} images have the stamp_s of the image before" in refusal(folder)
    write_rows(folder / "frames.csv", [{**row, "stamp_s": row["stamp_s"].split(".")[0]} for row in rows])
    assert "images have the stamp_s of the image before" in refusal(folder)


@pytest.mark.parametrize(("per_second", "unit"), [(10**3, "milliseconds"), (10**6, "microseconds"), (10**9, "nanoseconds")])
def test_unix_stamps_of_another_unit_are_named(per_second: int, unit: str, drive: Path, tmp_path: Path) -> None:
    folder = copy_of(drive, tmp_path / unit)
    rows = rows_of(folder / "odometry.csv")
    stamps = [round((1_790_000_000 + float(row["stamp_s"])) * per_second) for row in rows]
    write_rows(folder / "odometry.csv", [{**row, "stamp_s": str(stamp)} for row, stamp in zip(rows, stamps, strict=True)])
    assert f"is no time in seconds: {unit}? Divide by {per_second}" in refusal(folder)


def doctor(folder: Path) -> dict[str, Any]:
    done = subprocess.run([PROGRAM, "doctor", "--recording", folder, "--json"], capture_output=True, text=True, timeout=300)
    result: dict[str, Any] = json.loads(done.stdout)
    assert done.returncode == int(bool(result["warnings"])), done.stderr
    return result


def locate(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [str(PROGRAM), "locate", str(folder), "--out", str(folder / "poses.csv"), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


def spoil_images(folder: Path, spoil: Callable[[Path], bytes], first: int) -> None:
    """Replaces the images from this one on."""
    for row in rows_of(folder / "frames.csv")[first:]:
        path = folder / row["file"]
        content = spoil(path)
        path.unlink()
        path.write_bytes(content)


Pixels = NDArray[np.uint8]


def decode(path: Path) -> Pixels:
    image = cv2.imread(str(path))
    assert image is not None
    return np.asarray(image, dtype=np.uint8)


def encode(image: Pixels) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def black(path: Path) -> bytes:
    return encode(np.zeros_like(decode(path)))


def half_transmitted(path: Path) -> bytes:
    image = decode(path)
    image[len(image) // 2 :] = 0
    return encode(image)


def truncated(path: Path) -> bytes:
    return path.read_bytes()[:20_000]


def test_right_drive_has_no_doubt_and_no_bad_image(drive: Path) -> None:
    found = doctor(drive)
    assert found["warnings"] == []
    assert found["image_faults"] == {"images": IMAGES, "problems": []}


def test_frozen_camera_is_named_and_judges_no_other_sensor(drive: Path, tmp_path: Path) -> None:
    folder = copy_of(drive, tmp_path / "frozen")
    last = (folder / rows_of(folder / "frames.csv")[99]["file"]).read_bytes()
    spoil_images(folder, lambda _: last, 100)
    found = doctor(folder)
    (doubt,) = found["warnings"]
    assert "100 of 200 images cannot be used" in doubt and "frozen camera" in doubt, doubt
    assert found["suggestions"] == [] and found["figures"]["wheels_agree"] > 0.95
    done = locate(folder, "--json")
    result = json.loads(done.stdout)
    assert result["warnings"] == [], result["warnings"]
    assert sum("frozen camera" in line for line in done.stderr.splitlines()) == 1, done.stderr
    assert result["predicted"] == 100 and result["tracking"] <= 100


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (black, "99 % of it is black (0 of 255)"),
        (half_transmitted, "the image is incomplete"),
        (truncated, "cannot read image"),
    ],
)
def test_images_that_cannot_be_used_are_counted(
    drive: Path, tmp_path: Path, spoil: Callable[[Path], bytes], reason: str
) -> None:
    folder = copy_of(drive, tmp_path / "spoilt")
    spoil_images(folder, spoil, 120)
    (doubt,) = doctor(folder)["warnings"]
    frames = rows_of(folder / "frames.csv")
    first, last = float(frames[120]["stamp_s"]), float(frames[-1]["stamp_s"])
    assert doubt.startswith(f"80 of 200 images cannot be used, from {first:.3f} to {last:.3f} s"), doubt
    assert reason in doubt and frames[120]["file"] in doubt
    done = locate(folder)
    assert sum(reason in line for line in done.stderr.splitlines()) == 1, done.stderr
    assert "80 predicted (no image matched)" in done.stdout


def test_images_of_another_size_are_one_line_and_the_reason(drive: Path, tmp_path: Path) -> None:
    folder = copy_of(drive, tmp_path / "cropped")
    spoil_images(folder, lambda path: encode(decode(path)[10:-10, 10:-10]), 0)
    found = doctor(folder)
    (doubt,) = found["warnings"]
    assert "200 of 200 images" in doubt and "wrong image size: 460 × 460 pixels (expected 480 × 480" in doubt, doubt
    words = subprocess.run([PROGRAM, "doctor", "--recording", folder], capture_output=True, text=True).stdout
    assert "little motion" not in words and "too few images can be used" in words
    done = locate(folder)
    assert sum("wrong image size" in line for line in done.stderr.splitlines()) == 1, done.stderr


def test_swapped_files_are_named(drive: Path, tmp_path: Path) -> None:
    folder = copy_of(drive, tmp_path / "swapped")
    frames = rows_of(folder / "frames.csv")
    for one in (60, 61, 130):
        frames[one]["file"], frames[one + 30]["file"] = frames[one + 30]["file"], frames[one]["file"]
    write_rows(folder / "frames.csv", frames)
    (warning,) = json.loads(locate(folder, "--json").stdout)["warnings"]
    assert "6 of 200 images contradict the images before and after them" in warning, warning
    assert frames[60]["file"] in warning


def freeze(rows: list[Row]) -> list[Row]:
    start = len(rows) // 2
    return [{**row, "heading_rad": rows[min(number, start)]["heading_rad"]} for number, row in enumerate(rows)]


def silence(rows: list[Row]) -> list[Row]:
    return rows[: len(rows) // 2]


def add_noise(rows: list[Row]) -> list[Row]:
    """40 degrees."""
    chance = random.Random(3)
    noisy = [float(row["heading_rad"]) + chance.gauss(0.0, math.radians(40.0)) for row in rows]
    return [{**row, "heading_rad": f"{heading:.6f}"} for row, heading in zip(rows, noisy, strict=True)]


@pytest.mark.parametrize(
    ("spoil", "words"),
    [(freeze, "the compass freezes"), (silence, "the compass falls silent"), (add_noise, "readings scatter")],
)
def test_compass_that_freezes_falls_silent_or_scatters_is_named(
    drive: Path, tmp_path: Path, spoil: Callable[[list[Row]], list[Row]], words: str
) -> None:
    folder = copy_of(drive, tmp_path / "compass")
    write_rows(folder / "compass.csv", spoil(rows_of(folder / "compass.csv")))
    found = doctor(folder)
    (doubt,) = found["warnings"]
    assert doubt.startswith("compass.csv: ") and words in doubt, doubt
