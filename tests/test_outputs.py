"""Outputs on a full disk, and of several processes at once, at the level of the process."""

import contextlib
import json
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "target" / "release" / "mirrorball"
SCENARIO = ROOT / "config" / "scenarios" / "demo.toml"
SEQUENCE = ROOT / "samples" / "sequence"
STRIP = ROOT / "samples" / "calibration"


def run(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=False, **options)


def on_full_disk(size: int) -> dict[str, Any]:
    """Options of a process whose files end at that size, with an error as on a full disk."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))

    return {"preexec_fn": limit, "restore_signals": False}


@contextlib.contextmanager
def virtual_robot(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """The simulated devices in a folder."""
    command = [str(part) for part in (PROGRAM, "sim", SCENARIO, "--hardware", folder, "--duration", 120)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as devices:
        assert devices.stderr is not None
        try:
            assert "the devices are ready" in devices.stderr.readline()
            yield devices
        finally:
            devices.kill()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_run_that_loses_an_output_fails_and_names_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    poses, log = out / "poses.csv", out / "game.mcap"
    with virtual_robot(tmp_path / "robot"):
        poses.write_text("of an earlier run")
        done = run("run", "--robot", tmp_path / "robot", "--out", poses, "--duration", 2, "--json", **on_full_disk(1000))
        assert done.returncode == 1
        assert done.stderr.splitlines()[-1].startswith("mirrorball: cannot write the poses: "), done.stderr
        lost = json.loads(done.stdout)["outputs_lost"]
        assert len(lost) == 1 and "poses.csv" in lost[0] and "too large" in lost[0], lost
        assert poses.read_text() == "of an earlier run" and names(out) == ["poses.csv"]
        # The files at the log's start fit, the first cycles do not.
        start = run("run", "--robot", tmp_path / "robot", "--record", log, "--duration", 0.2, "--images", "none")
        assert start.returncode == 0, start.stderr
        with log.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        size = 100 + max(each.offset + each.length for each in summary.attachment_indexes)
        log.unlink()
        done = run("run", "--robot", tmp_path / "robot", "--record", log, "--duration", 2, **on_full_disk(size))
        assert done.returncode == 1
        message = done.stderr.splitlines()[-1]
        assert message.startswith("mirrorball: ") and "was removed, because the disk was full" in message, done.stderr
        assert names(out) == ["poses.csv"]


def test_log_that_a_full_disk_ends_stays_and_the_run_says_what_is_missing(tmp_path: Path) -> None:
    log = tmp_path / "game.mcap"
    with virtual_robot(tmp_path / "robot"):
        options = ("--robot", tmp_path / "robot", "--record", log, "--duration", 3, "--images", "png", "--json")
        done = run("run", *options, **on_full_disk(3_000_000))
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert report["log"]["files"][0] == str(log) and report["outputs_lost"] == []
    summary = report["log"]
    assert summary["cycles"] > 0 and summary["images"] > 0 and summary["cycles_dropped"] > 0, summary
    assert 0.0 < summary["incomplete_since_s"] < 3.0, summary
    assert any("the log is incomplete" in warning for warning in report["warnings"]), report["warnings"]
    verified = json.loads(run("replay", log, "--verify", "--json").stdout)["verified"]
    assert verified["identical"] and not verified["whole"] and 0 < verified["cycles"] <= summary["cycles"]
    assert run("recover", log, "--out", tmp_path / "whole.mcap").returncode == 0


def test_map_that_cannot_be_written_fails_at_the_start(tmp_path: Path) -> None:
    path, poses = tmp_path / "none" / "map.npz", tmp_path / "poses.csv"
    for command in (("locate", SEQUENCE, "--out", poses), ("run", "--robot", SEQUENCE)):
        done = run(*command, "--save-map", path)
        assert done.returncode == 1 and not poses.exists()
        assert done.stderr == f"mirrorball: cannot write {path}: No such file or directory (os error 2)\n", done.stderr


def test_run_never_replaces_an_earlier_log(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    log = out / "game.mcap"
    log.write_text("of an earlier run")
    with virtual_robot(tmp_path / "robot"):
        done = run("run", "--robot", tmp_path / "robot", "--record", log, "--duration", 1, "--json")
        assert done.returncode == 0, done.stderr
        assert f"{log} exists and stays: the log is written to {out / 'game.2.mcap'}" in done.stderr
        assert json.loads(done.stdout)["log"]["files"] == [str(out / "game.2.mcap")]
        failed = run("run", "--robot", tmp_path / "robot", "--record", log, "--duration", 1, **on_full_disk(1000))
        assert failed.returncode == 1 and "game.3.mcap" in failed.stderr, failed.stderr
    assert log.read_text() == "of an earlier run" and names(out) == ["game.2.mcap", "game.mcap"]
    assert run("replay", out / "game.2.mcap", "--verify").returncode == 0


def test_simulation_that_fails_leaves_the_earlier_log(tmp_path: Path) -> None:
    log = tmp_path / "game.mcap"
    log.write_text("of an earlier run")
    simulate = ("sim", SCENARIO, "--record", log, "--duration")
    done = run(*simulate, 3, **on_full_disk(1_000_000))
    assert done.returncode == 1 and f"cannot write {log}" in done.stderr, done.stderr
    assert log.read_text() == "of an earlier run" and names(tmp_path) == ["game.mcap"]
    # Another output fails after the log has begun.
    done = run(*simulate, 3, "--out", "/dev/full")
    assert done.returncode == 1 and "/dev/full" in done.stderr, done.stderr
    assert log.read_text() == "of an earlier run" and names(tmp_path) == ["game.mcap"]
    assert run(*simulate, 1).returncode == 0
    assert run("replay", log, "--verify").returncode == 0 and names(tmp_path) == ["game.mcap"]


def test_simulations_with_the_same_output_do_not_mix(tmp_path: Path) -> None:
    def command(seed: int, folder: Path) -> list[object]:
        options = ["--duration", 4, "--record", folder / "game.mcap", "--out", folder / "poses.csv"]
        return ["sim", SCENARIO, "--seed", seed, *options]

    alone = []
    for seed in (1, 2):
        folder = tmp_path / f"alone_{seed}"
        folder.mkdir()
        assert run(*command(seed, folder)).returncode == 0
        alone.append((folder / "poses.csv").read_text())
    assert alone[0] != alone[1]
    both = tmp_path / "both"
    both.mkdir()
    processes = [subprocess.Popen([PROGRAM, *map(str, command(seed, both))], stdout=subprocess.DEVNULL) for seed in (1, 2)]
    assert [process.wait(120) for process in processes] == [0, 0]
    assert (both / "poses.csv").read_text() in alone
    assert run("replay", both / "game.mcap", "--verify").returncode == 0
    assert names(both) == ["game.mcap", "poses.csv"]


def test_folder_of_virtual_devices_has_one_server(tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    with virtual_robot(robot) as first:
        second = run("sim", SCENARIO, "--hardware", robot, "--duration", 1, timeout=60)
        assert second.returncode == 1
        wanted = f"{robot} is served by another `sim --hardware` (process {first.pid}). End it, or name another folder"
        assert second.stderr == f"mirrorball: {wanted}\n"
        done = run("run", "--robot", robot, "--duration", 1, "--json")
        assert json.loads(done.stdout)["frames"] > 10, done.stderr
        first.kill()
        first.wait(30)
    # The kernel has freed the folder.
    assert run("sim", SCENARIO, "--hardware", robot, "--duration", 1, timeout=60).returncode == 0


def test_quotation_mark_that_swallows_frames_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(SEQUENCE, folder)
    frames = folder / "frames.csv"
    lines = frames.read_text().splitlines()
    stamp, _, file = lines[5].partition(",")
    frames.write_text("\n".join([*lines[:5], f'{stamp},"{file}', *lines[6:]]) + "\n")
    done = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert done.returncode == 1
    assert done.stderr == f"mirrorball: {frames}: line 6: a quotation mark that is not closed on its line\n"


def test_recording_without_a_pose_is_a_warning(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(SEQUENCE, folder)
    assert "warning" not in run("locate", folder, "--out", tmp_path / "poses.csv").stderr
    # Points that lie on no marking: a small square around the robot.
    points = [f"{0.1 * frame},{x},{y}" for frame in range(20) for x in (-1.05, 1.05) for y in (-1.05, 1.05)]
    (folder / "points.csv").write_text("\n".join(["stamp_s,x_m,y_m", *points]) + "\n")
    for name in ("odometry.csv", "compass.csv", "truth.csv"):
        (folder / name).unlink(missing_ok=True)
    done = run("locate", folder, "--out", tmp_path / "poses.csv", "--json")
    summary = json.loads(done.stdout)
    assert (done.returncode, summary["tracking"], summary["global"]) == (0, 0, 0), done.stderr
    assert sum("no pose in any of 20 frames" in line for line in done.stderr.splitlines()) == 1, done.stderr
    assert any("no pose in any of 20 frames" in warning for warning in summary["warnings"])


@pytest.mark.parametrize(("scale", "unit"), [(100, "centimetres"), (1000, "millimetres")])
def test_strip_in_another_unit_is_refused_with_file_value_and_unit(tmp_path: Path, scale: int, unit: str) -> None:
    folder = tmp_path / "strip"
    shutil.copytree(STRIP, folder)
    target = folder / "strip.toml"
    lengths = {"first_edge": 0.4, "spacing": 0.25, "width": 0.3}
    scaled = "\n".join(f"{key} = {scale * value:g}" for key, value in lengths.items())
    target.write_text(f'{scaled}\nbars = 23\nfirst_bar = "black"\n')
    done = run("calibrate", "map", folder, "--out", tmp_path / "map.npz")
    assert done.returncode == 1 and not (tmp_path / "map.npz").exists()
    assert f"{target}: line 1: first_edge = {scale * 0.4:g}: expected 0.05 to 2 metres" in done.stderr
    assert f"The file looks like {unit}" in done.stderr


def test_lines_of_another_field_and_copies_of_an_image_make_no_map(tmp_path: Path) -> None:
    folder, out = tmp_path / "recording", tmp_path / "map.npz"
    shutil.copytree(SEQUENCE, folder)
    right = run("calibrate", "lines", folder, "--out", out)
    assert right.returncode == 0 and out.exists(), right.stderr
    out.unlink()
    frames = (folder / "frames.csv").read_text()
    header, first, *rest = frames.splitlines()
    file = first.partition(",")[2]
    copies = [f"{row.partition(',')[0]},{file}" for row in rest]
    (folder / "frames.csv").write_text("\n".join([header, first, *copies]) + "\n")
    done = run("calibrate", "lines", folder, "--out", out)
    assert done.returncode == 1 and "1 of 20 (" in done.stderr and "the same picture as" in done.stderr, done.stderr
    (folder / "frames.csv").write_text(frames)
    field = folder / "field.toml"
    text = field.read_text().replace("length = 18.0", "length = 14.0").replace("width = 12.0", "width = 9.0")
    assert text != field.read_text()
    field.write_text(text)
    done = run("calibrate", "lines", folder, "--out", out)
    assert done.returncode == 1 and "the images do not show this field" in done.stderr, done.stderr
    assert "config/fields/msl_18x12.toml fits better" in done.stderr
    assert not out.exists()


def test_empty_scenario_is_named_as_one() -> None:
    done = run("sim", "/dev/null")
    assert (done.returncode, done.stderr) == (1, "mirrorball: /dev/null: an empty file: missing field `robot`\n")


def test_mirror_page_on_a_full_disk_is_one_message(tmp_path: Path) -> None:
    done = run("mirror", "report", "lima2001", "--out", tmp_path / "page", **on_full_disk(2000))
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1 and "File too large" in done.stderr and "page" in done.stderr, done.stderr
    done = run("calibrate", "map", STRIP, "--out", tmp_path / "map.npz", **on_full_disk(2000))
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].startswith("mirrorball: ") and "File too large" in done.stderr
    assert "Zip" not in done.stderr and "map.npz" in done.stderr, done.stderr


@pytest.mark.parametrize(
    ("design", "reason"),
    [
        ("[[part]]\nkind = ['cone']\n", "part 1: no kind ['cone']"),
        ("reach = 1" + 30 * "0", "reach is too large a number"),
        ("[[part]]\nkind = 'free'\npoints = { t = 1 }\n", "points = {'t': 1} must be rows of three numbers"),
        (None, "/dev/zero: not a regular file"),
    ],
)
def test_malformed_mirror_is_one_message(tmp_path: Path, design: str | None, reason: str) -> None:
    file = Path("/dev/zero") if design is None else tmp_path / "mirror.toml"
    head = "apex = 0.15\n"
    camera = "[camera]\nwidth_px = 480\nheight_px = 480\nfocal_px = 500.0\nheight = 0.6\n"
    if design is not None:
        is_table = design.startswith("[")
        file.write_text(head + camera + design if is_table else head + design + "\n" + camera)
    done = run("mirror", "design", file, "--out", tmp_path / "mirror.csv", timeout=60)
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and reason in done.stderr, done.stderr


def test_report_of_a_log_without_a_cycle_and_a_picture_of_an_unknown_kind_are_one_message(game: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(game.read_bytes()[:100_000])
    done = run("report", cut, "--out", tmp_path / "page")
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and f"{cut}: no cycle in this log" in done.stderr
    done = run("mirror", "render", "lima2001", "--out", tmp_path / "view.xyz")
    assert done.returncode == 1 and done.stderr.count("\n") == 1 and "no image format 'xyz'" in done.stderr


def test_calibration_that_could_not_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    out = tmp_path / "map.npz"
    outputs = [(out, tmp_path / "map.gif", "expected .png"), (tmp_path / "none" / "map.npz", tmp_path / "map.png", "No such")]
    for kind, folder in (("map", STRIP), ("lines", SEQUENCE)):
        for map_file, picture, reason in outputs:
            done = run("calibrate", kind, folder, "--out", map_file, "--picture", picture)
            assert done.returncode == 1 and done.stderr.count("\n") == 1 and reason in done.stderr, done.stderr
    done = run("calibrate", "lines", SEQUENCE, "--out", out, "--map", ROOT / "README.md")
    assert done.returncode == 1 and "README.md: no npz archive" in done.stderr, done.stderr
    assert list(tmp_path.iterdir()) == []


def test_killed_simulation_leaves_a_log_that_can_be_recovered_beside_the_earlier_one(tmp_path: Path) -> None:
    log = tmp_path / "game.mcap"
    log.write_text("of an earlier run")
    command = [str(part) for part in (PROGRAM, "sim", SCENARIO, "--duration", 600, "--record", log)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
        part = tmp_path / f"game.mcap.{running.pid}.part"
        until = time.monotonic() + 60
        while not part.exists() or part.stat().st_size < 3_000_000:
            assert time.monotonic() < until and running.poll() is None
            time.sleep(0.05)
        running.kill()
    assert log.read_text() == "of an earlier run"
    assert run("recover", part, "--out", tmp_path / "whole.mcap").returncode == 0
    assert run("replay", tmp_path / "whole.mcap", "--verify").returncode == 0


def test_output_that_is_an_input_is_refused_before_the_work(tmp_path: Path) -> None:
    """A scenario, its robot and field, a drive and its images, a drawing and a design stay as they are."""
    drive = tmp_path / "drive"
    shutil.copytree(SEQUENCE, drive)
    (tmp_path / "link").symlink_to(drive)
    robot, field, scenario = tmp_path / "robot.toml", tmp_path / "field.toml", tmp_path / "scenario.toml"
    shutil.copy(ROOT / "config/fields/msl_18x12.toml", field)
    robot.write_text(f'field = "field.toml"\n[mirror]\nprofile = "{ROOT}/config/mirrors/isometric.csv"\n')
    scenario.write_text('robot = "robot.toml"\n')
    drawing, design = tmp_path / "hall.svg", tmp_path / "mirror.toml"
    for path in (drawing, design):
        path.write_text("x = 1\n")
    image = next((drive / "frames").iterdir())
    refused: list[list[object]] = [
        ["sim", scenario, "--truth", scenario],
        ["sim", scenario, "--out", tmp_path / "drive" / ".." / "robot.toml"],
        ["sim", scenario, "--record", field],
        ["sim", scenario, "--hardware", tmp_path],
        ["calibrate", "wheels", drive, "--out", tmp_path / "link" / "odometry.csv"],
        ["calibrate", "imu", drive, "--out", drive / "robot.toml"],
        ["calibrate", "sizes", drive, "--out", drive / "frames.csv"],
        ["calibrate", "colours", drive, "--out", drive / "robot.toml"],
        ["calibrate", "mask", drive, "--out", drive / "frames.csv"],
        ["calibrate", "rim", drive, "--out", drive / "frames.csv"],
        ["calibrate", "rim", drive, "--picture", image],
        ["calibrate", "compass", drive, "--out", drive / "compass.csv"],
        ["calibrate", "lines", drive, "--out", tmp_path / "map.npz", "--picture", image],
        ["calibrate", "mount", drive, "--out", drive / "robot.toml"],
        ["field", "from-recording", drive, "--out", drive / "odometry.csv"],
        ["field", "from-svg", drawing, "--out", drawing],
        ["mirror", "design", design, "--out", design],
        ["locate", drive, "--points", image],
        ["run", "--robot", robot, "--out", robot],
    ]
    before = {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}
    for command in refused:
        result = run(*command)
        assert result.returncode == 2, command
        assert "is an input of" in result.stderr, (command, result.stderr)
        assert "choose another name" in result.stderr
    assert {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()} == before
