"""Does the exposure control of a running robot reach its camera? On the virtual hardware, whose camera obeys."""

import csv
import math
import signal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from test_robot import ROOT, StateOutput, ended, hardware, start, states  # noqa: F401

# Images after the end of a change of light by which the brightness has recovered, and within which factor.
RECOVERY_IMAGES = 10
RECOVERY_FACTOR = 1.2
# Seconds of simulated time at which a change of light begins and ends, and for which the new light stays.
CHANGES_S = [(3.0, 4.0, 6.0), (6.0, 7.0, 9.0), (9.0, 10.0, 12.0)]
LEVELS = [1.0, 0.25, 1.0, 4.0]
FRAME_RATE_HZ = 30.0


def scenario(folder: Path) -> Path:
    """A drive under light that falls to a quarter, rises fourfold and rises fourfold again."""
    text = (ROOT / "config" / "scenarios" / "light_change.toml").read_text().split("[light]")[0]
    keyframes = [(0.0, LEVELS[0])]
    for (begin, end, _), before, after in zip(CHANGES_S, LEVELS, LEVELS[1:], strict=False):
        keyframes += [(begin, before), (end, after)]
    lines = ", ".join(f"{{ time = {time}, level = {level} }}" for time, level in keyframes)
    path = folder / "light.toml"
    text = text.replace('"../', f'"{ROOT}/config/')
    path.write_text(f"{text}[light]\nkeyframes = [{lines}]\n")
    return path


def brightness(path: Path) -> float:
    """Median of the green channel around the robot, 0 to 255: most of the pixels show carpet."""
    pixels: NDArray[np.uint8] = np.asarray(Image.open(path).convert("RGB"))
    height, width, _ = pixels.shape
    middle = pixels[height // 4 : 3 * height // 4, width // 4 : 3 * width // 4, 1]
    return float(np.median(middle))


def test_brightness_recovers_and_nobody_is_lost_when_the_light_changes(tmp_path: Path, states: StateOutput) -> None:  # noqa: F811
    robot, log, truth_path = tmp_path / "robot", tmp_path / "light.mcap", tmp_path / "truth.csv"
    sim = hardware(robot, "--own-path", "--truth", truth_path, scenario=scenario(tmp_path))
    files = ["--record", log, "--images", "png", "--out", tmp_path / "poses.csv", "--network", states.network]
    run = start("run", "--robot", robot, *files, "--json")

    def simulated_images() -> list[float]:
        """Stamps of the images that were simulated, one for each 1/30 s of simulated time."""
        lines = truth_path.read_text().splitlines()[1:-1] if truth_path.exists() else []
        return [float(line.split(",")[0]) for line in lines]

    while len(simulated_images()) < CHANGES_S[-1][2] * FRAME_RATE_HZ:
        states.wait(30)
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    ended(start("replay", log, "--export", tmp_path / "recording", "--json"))
    with (tmp_path / "recording" / "frames.csv").open() as file:
        images = [(float(row["stamp_s"]), row["file"]) for row in csv.DictReader(file)]
    stamps = simulated_images()
    for begin, end, until in CHANGES_S:
        at = [stamps[round(time * FRAME_RATE_HZ)] for time in (begin, end, until)]
        before = [file for stamp, file in images if stamp < at[0]][-1]
        after = [file for stamp, file in images if at[1] <= stamp < at[2]][RECOVERY_IMAGES:]
        reference = brightness(tmp_path / "recording" / before)
        changes = [brightness(tmp_path / "recording" / file) / reference for file in after[::4]]
        assert len(changes) > 5
        assert all(abs(math.log(change)) < math.log(RECOVERY_FACTOR) for change in changes), (begin, changes)
    with (tmp_path / "poses.csv").open() as file:
        modes = [row["mode"] for row in csv.DictReader(file)]
    found = modes.index("tracking")
    assert "lost" not in modes[found:] and report["frames"] > 100, report
    # What the log says about exposure is what the camera reported: the images verify.
    verified = ended(start("replay", log, "--verify", "--json"))["verified"]
    assert verified["identical"] and verified["cycles"] > 10, verified
