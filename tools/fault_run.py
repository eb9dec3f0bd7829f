#!/usr/bin/env python3
"""Does the robot keep running after faults? Runs virtual hardware that fails by plan, and judges each fault.

    tools/fault_run.py --minutes 10 --out out/faults

Starts `mirrorball sim --hardware --faults` and `mirrorball run --patrol --record`, adds faults of the operating
system (full disk, frozen process, closed reader of the status line), and checks: is each fault reported, does the robot
recover in time, do the wheels stop without a valid command, is the log readable? Exits with 1 if a check fails.
"""

import argparse
import bisect
import csv
import itertools
import json
import math
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "target" / "release" / "mirrorball"
SCENARIO = ROOT / "config" / "scenarios" / "demo.toml"
PATROL = "speed = 0.8\nwaypoints = [{ x = -3.0, y = -2.0, theta_deg = 40.0 }, { x = 0.0, y = 2.0 }, { x = -5.0, y = 1.0 }]\n"

# Kind, duration in seconds, device, and the state or a word of the reason that must be reported.
KINDS = [
    ("camera-freezes", 3.0, "camera", "stuck"),
    ("camera-silent", 3.0, "camera", "stalled"),
    ("camera-half-frame", 2.0, "camera", "stalled"),
    ("camera-unplugged", 3.0, "camera", "absent"),
    ("camera-clock", 4.0, "camera", "clock"),
    ("base-unplugged", 2.0, "base", "absent"),
    ("base-silent", 2.0, "base", "stalled"),
    ("base-garbage", 2.0, "base", "garbage"),
    ("base-noise", 6.0, "base", ""),
    ("base-restarts", 1.0, "base", "jumped"),
    ("base-clock", 4.0, "base", "stepped"),
    ("imu-unplugged", 2.0, "imu", "absent"),
    ("imu-stuck", 3.0, "imu", "stuck"),
    ("imu-nan", 3.0, "imu", "range"),
    ("imu-garbage", 2.0, "imu", "garbage"),
]
# Time without faults before the first fault, and after each.
START_S, PAUSE_S = 6.0, 6.0
# Truth is written at every sensor sample. A longer gap means that the simulation paused.
PAUSED_S = 0.5
# Largest position error of a correct pose.
NEAR_M = 0.3


@dataclass
class Verdict:
    """Result of one fault."""

    kind: str
    named: bool
    recovered_s: float | None
    # False if the simulation paused meanwhile, so that the fault says nothing about the robot.
    judged: bool = True
    problems: list[str] = field(default_factory=list)


def plan(seconds: float, kinds: list[tuple[str, float, str, str]], pause_s: float) -> list[dict[str, Any]]:
    """Plans consecutive faults, in rounds over all kinds, until the time is over."""
    faults, at, turn = [], START_S, 0
    while True:
        kind, lasts, _, _ = kinds[turn % len(kinds)]
        if at + lasts + pause_s > seconds or (turn >= len(kinds) and seconds <= 60.0):
            return faults
        step = -0.6 if (turn // len(kinds)) % 2 else 0.6
        faults.append({"kind": kind, "at": at, "for": lasts, "step": step})
        at += lasts + pause_s
        turn += 1


def write_plan(path: Path, faults: list[dict[str, Any]]) -> None:
    """Writes the plan in the format of `sim --faults`."""
    lines = []
    for fault in faults:
        lines += ["[[fault]]", *(f"{key} = {json.dumps(value)}" for key, value in fault.items()), ""]
    path.write_text("\n".join(lines))


class Processes:
    """The virtual hardware and the robot's process."""

    def __init__(self, program: Path, out: Path, seconds: float, faults: list[dict[str, Any]], rate: int) -> None:
        """Starts the hardware, then the robot."""
        self.out = out
        # `run` never replaces a log.
        for log in out.glob("log*.mcap"):
            log.unlink()
        (out / "patrol.toml").write_text(PATROL)
        write_plan(out / "faults.toml", faults)
        robot = out / "robot"
        hardware = [program, "sim", SCENARIO, "--hardware", robot, "--faults", out / "faults.toml", "--rate", str(rate)]
        hardware += ["--truth", out / "truth.csv", "--duration", str(seconds + 3.0), "--json"]
        self.sim = subprocess.Popen(
            [*map(str, hardware)], stdout=(out / "sim.json").open("w"), stderr=(out / "sim.err").open("w")
        )
        while not (robot / "hardware.toml").exists():
            if self.sim.poll() is not None:
                raise RuntimeError((out / "sim.err").read_text())
            time.sleep(0.02)
        play = [program, "run", "--robot", robot, "--patrol", out / "patrol.toml", "--record", out / "log.mcap"]
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        play += ["--out", out / "poses.csv", "--live", f"127.0.0.1:{self.port}", "--json"]
        # Python ignores SIGXFSZ, and the child inherits this. A full disk is then an error, not a signal.
        self.robot = subprocess.Popen(
            [*map(str, play)], stdout=(out / "run.json").open("w"), stderr=subprocess.PIPE, restore_signals=False
        )
        self.began = time.monotonic()

    def fill_disk(self, seconds: float) -> None:
        """Prevents files from growing for the given time."""
        size = max(file.stat().st_size for file in self.out.glob("log*.mcap"))
        _, hard = resource.prlimit(self.robot.pid, resource.RLIMIT_FSIZE)
        resource.prlimit(self.robot.pid, resource.RLIMIT_FSIZE, (min(size, 1 << 20), hard))
        time.sleep(seconds)
        resource.prlimit(self.robot.pid, resource.RLIMIT_FSIZE, (hard, hard))

    def freeze(self, seconds: float) -> None:
        """Stops the robot's process for the given time."""
        self.robot.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self.robot.send_signal(signal.SIGCONT)

    def watch(self) -> socket.socket:
        """Connects a viewer of the live stream that never reads its data."""
        viewer = None
        while viewer is None:
            try:
                viewer = socket.create_connection(("127.0.0.1", self.port), timeout=5.0)
            except ConnectionRefusedError:
                if time.monotonic() > self.began + 30.0:
                    raise
                time.sleep(0.1)
        lines = ["GET / HTTP/1.1", "Host: robot", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
        lines += ["Sec-WebSocket-Protocol: foxglove.sdk.v1", "", ""]
        viewer.sendall("\r\n".join(lines).encode())
        if b"101" not in viewer.recv(64):
            raise RuntimeError("the live stream does not answer")
        return viewer

    def vanish(self, viewer: socket.socket) -> None:
        """Closes the viewer and the reader of the status line in the middle of a message."""
        viewer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        viewer.close()
        if self.robot.stderr is not None:
            self.robot.stderr.close()

    def stop(self) -> float:
        """Terminates the robot's process as systemd does, then the hardware. Returns the time of the first, CLOCK_MONOTONIC."""
        stopped_s = time.monotonic()
        self.robot.terminate()
        self.robot.wait(20)
        time.sleep(1.0)
        self.sim.terminate()
        self.sim.wait(20)
        return stopped_s


def state_at(changes: list[dict[str, Any]], device: str, stamp: float) -> str:
    """State of the device at that time."""
    states = [change["state"] for change in changes if change["device"] == device and change["stamp_s"] <= stamp]
    return states[-1] if states else "absent"


def errors(out: Path) -> list[tuple[float, float]]:
    """Stamps and position errors of all frames. Infinite without a pose."""
    with (out / "truth.csv").open() as file:
        truth = [(float(row["stamp_s"]), float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(file)]
    stamps = [row[0] for row in truth]
    found = []
    with (out / "poses.csv").open() as file:
        for row in csv.DictReader(file):
            stamp = float(row["stamp_s"])
            place = min(max(bisect.bisect(stamps, stamp - 0.002), 0), len(truth) - 1)
            known = bool(row["x_m"]) and abs(stamps[place] - stamp) < 0.02
            error = math.hypot(float(row["x_m"]) - truth[place][1], float(row["y_m"]) - truth[place][2]) if known else math.inf
            found.append((stamp, error))
    return found


def pauses(out: Path) -> list[tuple[float, float]]:
    """Intervals in which the virtual hardware paused, because its process got no CPU time."""
    with (out / "truth.csv").open() as file:
        stamps = [float(row["stamp_s"]) for row in csv.DictReader(file)]
    return [(a, b) for a, b in itertools.pairwise(stamps) if b - a > PAUSED_S]


def judge(
    fault: dict[str, Any],
    report: dict[str, Any],
    poses: list[tuple[float, float]],
    paused: list[tuple[float, float]],
    within_s: float,
) -> Verdict:
    """Checks whether the fault was reported, and how long after its end the robot recovered."""
    device, word = next((device, word) for kind, _, device, word in KINDS if kind == fault["kind"])
    begin, end = fault["from_s"], fault["until_s"]
    changes = report["changes"]
    during = [c for c in changes if c["device"] == device and begin <= c["stamp_s"] <= end + within_s]
    named = not word or any(word == c["state"] or word in (c["reason"] or "") for c in during)
    # Time from the fault's end until the device runs and a pose is correct.
    recovered = 0.0
    if state_at(changes, device, end) != "running":
        back = [c["stamp_s"] - end for c in changes if c["device"] == device and c["stamp_s"] > end and c["state"] == "running"]
        recovered = min(back, default=math.inf)
    right = [stamp - end for stamp, error in poses if stamp > end and error < NEAR_M]
    recovered = max(recovered, min(right, default=math.inf))
    verdict = Verdict(fault["kind"], named, recovered if math.isfinite(recovered) else None)
    verdict.judged = not any(began < end + within_s and ended > begin for began, ended in paused)
    if not verdict.judged:
        return verdict
    if not named:
        verdict.problems.append(f"was not named ({device}: {word})")
    if recovered > within_s:
        verdict.problems.append(f"recovered after {recovered:.2f} s")
    return verdict


def reads(program: Path, out: Path) -> list[str]:
    """Problems of the logs."""
    if not list(out.glob("log*.mcap")):
        return ["there is no log"]
    problems = []
    for log in sorted(out.glob("log*.mcap")):
        whole = out / f"whole_{log.name}"
        done = subprocess.run([program, "recover", log, "--out", whole], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            problems.append(f"{log.name}: {done.stderr.strip()}")
        whole.unlink(missing_ok=True)
    return problems


def fault_run(
    out: Path,
    seconds: float,
    *,
    kinds: list[tuple[str, float, str, str]] = KINDS,
    pause_s: float = PAUSE_S,
    within_s: float = 1.0,
    rate: int = 30,
    program: Path = PROGRAM,
) -> tuple[list[Verdict], list[str], dict[str, Any]]:
    """Runs the plan. Returns verdicts on the faults, problems of the run, and a summary."""
    out.mkdir(parents=True, exist_ok=True)
    for old in [*out.glob("log*.mcap"), *(out / "robot").glob("*.toml")]:
        old.unlink()
    faults = plan(seconds, kinds, pause_s)
    processes = Processes(program, out, seconds, faults, rate)
    problems = []
    try:
        viewer = processes.watch()
        # Faults of the operating system, in pauses between the planned ones.
        for share, name in [(0.3, "disk"), (0.5, "frozen"), (0.7, "viewer")]:
            before = faults[int(share * len(faults))]
            quiet = before["at"] + before["for"] + 0.5 * pause_s
            time.sleep(max(0.0, processes.began + quiet - time.monotonic()))
            if name == "disk":
                processes.fill_disk(3.0)
            elif name == "frozen":
                processes.freeze(min(1.0, 0.25 * pause_s))
            else:
                processes.vanish(viewer)
        time.sleep(max(0.0, processes.began + seconds - time.monotonic()))
        if processes.robot.poll() is not None:
            problems.append(f"the robot's process ended by itself with {processes.robot.returncode}")
    finally:
        stopped_s = processes.stop()
    if processes.robot.returncode != 0:
        problems.append(f"run ended with {processes.robot.returncode}")
    report = json.loads((out / "run.json").read_text())
    hardware = json.loads((out / "sim.json").read_text())
    commands = hardware["commands"]
    if commands["too_long"] or commands["driven_at_once"] or commands["last_driving_s"] > stopped_s + 0.1:
        problems.append(f"the wheels were driven without a fresh command: {commands}")
    if not commands["driving"] or not report["wheels_stopped"] or not commands["stands_last"]:
        problems.append(f"the wheels got no stop command at the end: {commands}")
    if not commands["ran_out"]:
        problems.append("the frozen process's last command did not run out")
    if len(report["log"]["files"]) < 2:
        problems.append("no new log was begun after the disk was full")
    problems += reads(program, out)
    poses = errors(out)
    paused = pauses(out)
    verdicts = [judge(fault, report, poses, paused, within_s) for fault in hardware["faults"]]
    unjudged = {verdict.kind for verdict in verdicts} - {verdict.kind for verdict in verdicts if verdict.judged}
    if unjudged:
        problems.append(f"this machine left no time to judge {', '.join(sorted(unjudged))}")
    near = sorted(error for _, error in poses)
    summary = {
        "seconds": report["seconds"],
        "latency_ms": report["latency_ms"],
        "error_median_m": near[len(near) // 2],
        "memory_mb": [report["memory_first_mb"], report["memory_max_mb"], report["memory_mb"]],
        "logs": len(report["log"]["files"]),
        "slipped_s": hardware["slipped_s"],
        "commands": commands,
    }
    return verdicts, problems, summary


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=int, default=30, help="images per second")
    parser.add_argument("--out", type=Path, default=Path("out/faults"))
    parser.add_argument("--program", type=Path, default=PROGRAM, help="the executable to try")
    given = parser.parse_args()
    verdicts, problems, summary = fault_run(given.out, 60.0 * given.minutes, rate=given.rate, program=given.program)
    for verdict in verdicts:
        after = "never" if verdict.recovered_s is None else f"{verdict.recovered_s:5.2f} s"
        named = "named" if verdict.named else "NOT NAMED"
        if not verdict.judged:
            print(f"{verdict.kind:<18} not judged: the world itself stood still")
            continue
        print(f"{verdict.kind:<18} {named:<10} well again after {after}  {'; '.join(verdict.problems)}")
    print(json.dumps(summary, indent=1))
    for problem in problems:
        print(f"problem: {problem}")
    failed = len(problems) + sum(bool(verdict.problems) for verdict in verdicts)
    print(f"{len(verdicts)} faults, {failed} wrong answers")
    return int(failed > 0)


if __name__ == "__main__":
    os.environ.setdefault("MIRRORBALL_HOME", str(ROOT))
    sys.exit(main())
