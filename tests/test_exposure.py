"""Does the exposure control of a running robot reach its camera? On the virtual hardware, whose camera obeys."""

import csv
import math
import signal
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mirrorball import analysis
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


def assert_setting_in_force_is_that_of_the_camera(log: Path, simulated: list[dict[str, str]]) -> None:
    """The log states for each image the exposure and gain with which the virtual camera took it."""
    of_camera = {round(float(row["stamp_s"]), 6): (float(row["exposure_s"]), float(row["gain"])) for row in simulated}
    stated = analysis.table(log, "/cycle")
    pairs = []
    # What the camera reported with each image, and what the exposure control assumes where it looks at one.
    for kind in ("reported_exposure", "reported_gain"), ("exposure_exposure", "exposure_gain"):
        logged = stated[["stamp_ns", *kind]].dropna().itertuples(index=False, name=None)
        pairs.append([(of_camera[at], setting) for ns, *setting in logged if (at := round(1e-9 * ns, 6)) in of_camera])
    reported, assumed = pairs
    assert len(reported) > 0.9 * len(stated) > 100 and len(assumed) > 50, (len(reported), len(assumed), len(stated))
    # Microseconds and hundredths, in which the camera's images carry them.
    wrong = [
        pair for pair in reported + assumed if abs(pair[0][0] - pair[1][0]) > 1.1e-6 or abs(pair[0][1] - pair[1][1]) > 0.011
    ]
    assert not wrong, wrong[:5]
    # The light fell to a quarter and rose sixteenfold: so did exposure times gain, inversely.
    light = [exposure * gain for (exposure, gain), _ in reported]
    assert max(light) > 8.0 * min(light), (min(light), max(light))


def test_brightness_recovers_and_nobody_is_lost_when_the_light_changes(tmp_path: Path, states: StateOutput) -> None:  # noqa: F811
    robot, log, truth_path = tmp_path / "robot", tmp_path / "light.mcap", tmp_path / "truth.csv"
    sim = hardware(robot, "--own-path", "--truth", truth_path, scenario=scenario(tmp_path))
    files = ["--record", log, "--images", "jpeg", "--out", tmp_path / "poses.csv", "--network", states.network]
    run = start("run", "--robot", robot, *files, "--json")

    # Each state is of another image, and simulated time waits for a slow machine.
    for _ in range(round(CHANGES_S[-1][2])):
        states.wait(round(FRAME_RATE_HZ))
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    ended(start("replay", log, "--export", tmp_path / "recording", "--json"))
    # A slow machine drops images from the log: those that are there count.
    with (tmp_path / "recording" / "frames.csv").open() as file:
        images = [(float(row["stamp_s"]), row["file"]) for row in csv.DictReader(file)]
    with truth_path.open() as file:
        # One for each simulated image.
        simulated = list(csv.DictReader(file))
    stamps = [float(row["stamp_s"]) for row in simulated]
    with (tmp_path / "poses.csv").open() as file:
        processed = [float(row["stamp_s"]) for row in csv.DictReader(file)]
    first_change = stamps[round(CHANGES_S[0][0] * FRAME_RATE_HZ)]
    before = [file for stamp, file in images if stamp < first_change][-1]
    # Of the light before all changes: each one may leave a rest, but the rests must not add up.
    reference = brightness(tmp_path / "recording" / before)
    for begin, end, until in CHANGES_S:
        at = [stamps[round(time * FRAME_RATE_HZ)] for time in (begin, end, until)]
        recovered = [stamp for stamp in processed if stamp >= at[1]][RECOVERY_IMAGES]
        after = [file for stamp, file in images if recovered <= stamp < at[2]]
        changes = [brightness(tmp_path / "recording" / file) / reference for file in after[:: max(1, len(after) // 12)]]
        assert len(changes) > 5, f"{len(after)} images, {report['log']}"
        assert all(abs(math.log(change)) < math.log(RECOVERY_FACTOR) for change in changes), (begin, changes)
    assert_setting_in_force_is_that_of_the_camera(log, simulated)
    with (tmp_path / "poses.csv").open() as file:
        modes = [row["mode"] for row in csv.DictReader(file)]
    found = modes.index("tracking")
    assert "lost" not in modes[found:] and report["frames"] > 100, report
    verified = ended(start("replay", log, "--verify", "--json"))["verified"]
    assert verified["identical"] and verified["cycles"] > 10, verified
