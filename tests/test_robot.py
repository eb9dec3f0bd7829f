"""Does `mirrorball run` run the simulated robot through its real wire formats? The virtual hardware."""

import contextlib
import csv
import json
import math
import os
import pty
import random
import signal
import socket
import subprocess
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "target" / "release" / "mirrorball"
SCENARIO = ROOT / "config" / "scenarios" / "demo.toml"
# Time for which the simulation goes on after a run, to show that the wheels stand, seconds.
OBSERVATION_S = 1.0


def start(*arguments: object, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [PROGRAM, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


def wait_for(path: Path) -> None:
    until = time.monotonic() + 60
    while not path.exists():
        assert time.monotonic() < until, path
        time.sleep(0.02)


def hardware(folder: Path, *more: object, scenario: Path = SCENARIO) -> subprocess.Popen[str]:
    process = start("sim", scenario, "--hardware", folder, "--duration", 300, "--json", *more)
    wait_for(folder / "hardware.toml")
    return process


class StateOutput:
    """The states that a run sends by UDP: a test waits for them instead of sleeping."""

    def __init__(self, folder: Path) -> None:
        self.socket = socket.socket(type=socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(60)
        self.network = folder / "outputs.toml"
        port = self.socket.getsockname()[1]
        self.network.write_text(f'[[outputs]]\nto = "127.0.0.1:{port}"\nformat = "json"\n')

    def wait(self, count: int) -> None:
        """Waits for `count` states with a pose."""
        until = time.monotonic() + 60
        while count > 0:
            assert time.monotonic() < until, f"{count} states with a pose are missing"
            if json.loads(self.socket.recv(65535)).get("pose") is not None:
                count -= 1


@pytest.fixture
def states(tmp_path: Path) -> Iterator[StateOutput]:
    output = StateOutput(tmp_path)
    yield output
    output.socket.close()


def stop(process: subprocess.Popen[str]) -> None:
    """Stops a process (SIGSTOP): on a loaded machine its threads run on for a while after the signal."""
    process.send_signal(signal.SIGSTOP)
    _, status = os.waitpid(process.pid, os.WUNTRACED)
    assert os.WIFSTOPPED(status), status


def ended(process: subprocess.Popen[str]) -> dict[str, Any]:
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    result: dict[str, Any] = json.loads(out)
    return result


def assert_wall_time(log: Path, started_ns: int) -> None:
    """Log times are those of the wall clock, and the metadata hold its offset from the clock of the stamps."""
    with log.open("rb") as file:
        reader = make_reader(file)
        times = [message.log_time for _, _, message in reader.iter_messages(topics=["/cycle"])]
        offsets = [metadata.metadata.get("clock_offset_ns") for metadata in reader.iter_metadata()]
    assert times and started_ns < min(times) <= max(times) < time.time_ns()
    expected = time.time_ns() - time.monotonic_ns()
    assert any(offset is not None and abs(int(offset) - expected) < 1e9 for offset in offsets), offsets


def test_run_locates_the_virtual_robot_and_stops_its_wheels_at_the_end(tmp_path: Path, states: StateOutput) -> None:
    robot, patrol = tmp_path / "robot", tmp_path / "patrol.toml"
    patrol.write_text("speed = 0.8\nwaypoints = [{ x = -3.0, y = -2.0, theta_deg = 40.0 }, { x = 0.0, y = 2.0 }]\n")
    started_ns = time.time_ns()
    sim = hardware(robot, "--truth", tmp_path / "truth.csv", "--format", "YUYV")
    files = ["--record", tmp_path / "a.mcap", "--out", tmp_path / "poses.csv", "--network", states.network]
    run = start("run", "--robot", robot, "--patrol", patrol, *files, "--json")
    states.wait(150)
    stop_requested = time.monotonic()
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    assert_wall_time(tmp_path / "a.mcap", started_ns)
    time.sleep(OBSERVATION_S)
    sim.send_signal(signal.SIGTERM)
    commands = ended(sim)["commands"]
    assert report["wheels_stopped"] and report["frames"] > 30
    assert [device["state"] for device in report["devices"]] == ["running"] * 3
    assert commands["driving"] > 100 and commands["too_long"] == 0
    assert commands["last_driving_s"] < stop_requested + 0.5 and commands["stands_last"]
    with (tmp_path / "truth.csv").open() as file:
        truth = {round(float(row["stamp_s"]), 6): (float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(file)}
    with (tmp_path / "poses.csv").open() as file:
        poses = [row for row in csv.DictReader(file) if row["x_m"] and round(float(row["stamp_s"]), 6) in truth]
    errors = []
    for row in poses:
        x, y = truth[round(float(row["stamp_s"]), 6)]
        errors.append(math.hypot(float(row["x_m"]) - x, float(row["y_m"]) - y))
    assert len(errors) > 0.9 * report["frames"]
    assert sorted(errors)[len(errors) // 2] < 0.03
    verified = start("replay", tmp_path / "a.mcap", "--verify", "--json")
    ended(verified)


def test_killed_run_loses_at_most_one_second_of_log_and_the_wheels_stop(tmp_path: Path, states: StateOutput) -> None:
    robot, patrol = tmp_path / "robot", tmp_path / "patrol.toml"
    patrol.write_text("waypoints = [{ x = 3.0, y = 0.0 }, { x = -3.0, y = 0.0 }]\n")
    sim = hardware(robot)
    run = start("run", "--robot", robot, "--patrol", patrol, "--record", tmp_path / "a.mcap", "--network", states.network)
    states.wait(120)
    run.kill()
    killed = time.monotonic()
    run.communicate()
    done = ended(start("recover", tmp_path / "a.mcap", "--out", tmp_path / "whole.mcap", "--json"))
    assert done
    exported = start("replay", tmp_path / "whole.mcap", "--export", tmp_path / "recording", "--json")
    ended(exported)
    with (tmp_path / "recording" / "frames.csv").open() as file:
        last = max(float(row["stamp_s"]) for row in csv.DictReader(file))
    assert killed - last < 1.0
    time.sleep(OBSERVATION_S)
    sim.send_signal(signal.SIGINT)
    commands = ended(sim)["commands"]
    assert commands["ran_out"] >= 1 and commands["last_driving_s"] < killed + 0.1


def switch_off(folder: Path) -> None:
    """A robot none of whose devices is there."""
    sim = hardware(folder)
    sim.kill()
    sim.communicate()
    for device in ("base", "wit", "camera"):
        (folder / device).unlink(missing_ok=True)


def test_run_waits_for_devices_and_fails_if_none_answers_within_its_duration(tmp_path: Path) -> None:
    switch_off(tmp_path / "robot")
    run = start("run", "--robot", tmp_path / "robot", "--duration", 1, "--json")
    out, err = run.communicate(timeout=60)
    assert [device["state"] for device in json.loads(out)["devices"]] == ["absent"] * 3
    assert run.returncode == 1 and "no device delivered anything in 1." in err.splitlines()[-1], err
    assert "(base: absent, camera: absent, imu: absent). `mirrorball doctor" in err and "0 Hz" not in err, err


def test_doctor_names_the_remedy_of_absent_devices(tmp_path: Path) -> None:
    switch_off(tmp_path / "robot")
    doctor = start("doctor", "--robot", tmp_path / "robot", "--logs", tmp_path, "--json")
    out, err = doctor.communicate(timeout=60)
    assert doctor.returncode == 1 and "keep" in err
    bad = [finding for finding in json.loads(out)["findings"] if finding["verdict"] == "bad"]
    assert len(bad) == 3 and all("plug it in" in finding["remedy"] for finding in bad)


def test_doctor_finds_no_problem_of_a_running_robot(tmp_path: Path) -> None:
    sim = hardware(tmp_path / "robot")
    doctor = start("doctor", "--robot", tmp_path / "robot", "--logs", tmp_path, "--json")
    out, err = doctor.communicate(timeout=60)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    assert doctor.returncode == 0, (out, err)
    assert {"sight", "robot.toml", "hardware.toml"} <= {finding["what"] for finding in json.loads(out)["findings"]}


def test_invalid_robot_folder_is_reported_in_one_line(tmp_path: Path) -> None:
    run = start("run", "--robot", tmp_path / "nothing")
    _, err = run.communicate(timeout=60)
    assert run.returncode == 1 and len(err.splitlines()) == 1 and "hardware.toml" in err
    for arguments, code in [(["run"], 2), (["run", "--list"], 0)]:
        process = start(*arguments)
        process.communicate(timeout=60)
        assert process.returncode == code


def test_key_drives_until_its_hold_time_ends(tmp_path: Path, states: StateOutput) -> None:
    sim = hardware(tmp_path / "robot")
    terminal, end = pty.openpty()
    arguments = ["--robot", tmp_path / "robot", "--teleop", "--network", states.network, "--json"]
    run = start("run", *arguments, preexec_fn=in_own_terminal(end))
    states.wait(30)
    os.write(terminal, b"w")
    # More than the 0.6 s for which one key press drives.
    states.wait(60)
    os.write(terminal, b"x")
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    commands = ended(sim)["commands"]
    os.close(terminal)
    os.close(end)
    assert report["wheels_stopped"]
    # One key press drives for 0.6 s at 100 commands a second.
    assert 20 < commands["driving"] < 120 and commands["stands_last"]


def in_own_terminal(end: int) -> Callable[[], None]:
    """Makes a pseudo terminal the terminal of the process that calls the result."""

    def take() -> None:
        os.setsid()
        import fcntl

        fcntl.ioctl(end, termios.TIOCSCTTY, 0)

    return take


def test_run_whose_terminal_is_closed_ends_with_a_complete_log(tmp_path: Path, states: StateOutput) -> None:
    sim = hardware(tmp_path / "robot")
    terminal, end = pty.openpty()
    arguments = ["run", "--robot", tmp_path / "robot", "--network", states.network, "--record", tmp_path / "a.mcap"]
    run = subprocess.Popen([PROGRAM, *map(str, arguments)], stdin=end, stdout=end, stderr=end, preexec_fn=in_own_terminal(end))
    os.close(end)
    reader = threading.Thread(target=read_to_the_end, args=[terminal], daemon=True)
    reader.start()
    states.wait(30)
    # The reader has the terminal open until the run is told: closing the last descriptor hangs it up.
    os.kill(run.pid, signal.SIGSTOP)
    os.close(terminal)
    os.kill(run.pid, signal.SIGHUP)
    os.kill(run.pid, signal.SIGCONT)
    # The report cannot be written. A panic in the report of that would abort the process.
    assert run.wait(60) in (0, 1)
    sim.send_signal(signal.SIGTERM)
    assert ended(sim)["commands"]["stands_last"]
    with (tmp_path / "a.mcap").open("rb") as file:
        assert make_reader(file).get_summary() is not None


@pytest.mark.parametrize("command", ["run", "record"])
def test_quit_key_of_the_terminal_stops_the_wheels_and_leaves_the_terminal_as_it_was(command: str, tmp_path: Path) -> None:
    sim = hardware(tmp_path / "robot")
    terminal, end = pty.openpty()
    settings = termios.tcgetattr(terminal)
    log = tmp_path / "a.mcap"
    output = ["--record", log] if command == "run" else ["--out", log]
    driven = start(command, "--robot", tmp_path / "robot", "--teleop", *output, "--json", preexec_fn=in_own_terminal(end))
    wait_for(log)
    while termios.tcgetattr(terminal)[3] & termios.ICANON:
        time.sleep(0.02)
    # A held key.
    for _ in range(40):
        os.write(terminal, b"w")
        time.sleep(0.03)
    os.write(terminal, b"\x1c")
    quit_at = time.monotonic()
    ended(driven)
    assert termios.tcgetattr(terminal) == settings
    os.close(terminal)
    os.close(end)
    sim.send_signal(signal.SIGTERM)
    commands = ended(sim)["commands"]
    assert commands["driving"] > 10 and commands["stands_last"], commands
    assert commands["last_driving_s"] < quit_at + 0.5, commands
    with log.open("rb") as file:
        assert make_reader(file).get_summary() is not None


def test_run_that_a_closed_terminal_ends_succeeds(tmp_path: Path, states: StateOutput) -> None:
    sim = hardware(tmp_path / "robot")
    terminal, end = pty.openpty()
    arguments = ["run", "--robot", tmp_path / "robot", "--network", states.network]
    run = subprocess.Popen([PROGRAM, *map(str, arguments)], stdin=end, stdout=end, stderr=end, preexec_fn=in_own_terminal(end))
    os.close(end)
    states.wait(30)
    os.close(terminal)
    assert run.wait(60) == 0
    sim.send_signal(signal.SIGTERM)
    assert ended(sim)["commands"]["stands_last"]


def test_teleop_without_a_terminal_says_that_there_is_no_keyboard(tmp_path: Path) -> None:
    sim = hardware(tmp_path / "robot")
    arguments = ["run", "--robot", tmp_path / "robot", "--teleop", "--duration", 1]
    program = [str(PROGRAM), *map(str, arguments)]
    done = subprocess.run(
        program, stdin=subprocess.DEVNULL, start_new_session=True, capture_output=True, text=True, check=False
    )
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    assert done.returncode == 0 and "no keyboard: the program has no terminal" in done.stderr, done.stderr


def read_to_the_end(descriptor: int) -> None:
    with contextlib.suppress(OSError):
        while os.read(descriptor, 4096):
            pass


def free_port() -> int:
    """A port of the loopback that is free for TCP and UDP. The system gives none of this range to others meanwhile."""
    while True:
        port = random.randrange(15_000, 32_000)
        with socket.socket() as stream, socket.socket(type=socket.SOCK_DGRAM) as datagrams, contextlib.suppress(OSError):
            stream.bind(("127.0.0.1", port))
            datagrams.bind(("127.0.0.1", port))
            return port


@pytest.mark.parametrize("base", ["vesc-uart", "vesc-slcan"])
def test_robot_with_vescs_is_driven_and_stopped(tmp_path: Path, base: str, states: StateOutput) -> None:
    robot, patrol = tmp_path / "robot", tmp_path / "patrol.toml"
    patrol.write_text("speed = 0.8\nwaypoints = [{ x = -3.0, y = -2.0 }, { x = 0.0, y = 2.0 }]\n")
    sim = hardware(robot, "--base", base, "--truth", tmp_path / "truth.csv")
    run = start("run", "--robot", robot, "--patrol", patrol, "--network", states.network, "--json")
    states.wait(120)
    stop_requested = time.monotonic()
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    time.sleep(OBSERVATION_S)
    sim.send_signal(signal.SIGTERM)
    stats = ended(sim)["commands"]
    state = {device["device"]: device for device in report["devices"]}
    assert state["base"]["state"] == "running" and state["base"]["damaged"] == 0, state["base"]
    assert report["wheels_stopped"] and report["tracking"] > 60
    assert stats["driving"] > 100 and stats["driven_at_once"] == 0
    assert stats["last_driving_s"] < stop_requested + 0.5 and stats["stands_last"]
    with (tmp_path / "truth.csv").open() as file:
        truth = [(float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(file)]
    assert math.dist(truth[0], truth[-1]) > 0.5
