"""Who drives the robot? Commands of other programs, as sent, held back, recorded and forged, at the level of the process."""

import csv
import hmac
import json
import math
import os
import pty
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from test_robot import ended, free_port, hardware, in_own_terminal, start, stop


class Program:
    """Another program that drives the robot: it reads the states and sends commands under a key."""

    KEY = "known to both sides"

    def __init__(self, folder: Path) -> None:
        self.states = socket.socket(type=socket.SOCK_DGRAM)
        self.states.bind(("127.0.0.1", 0))
        self.states.settimeout(60)
        self.out = socket.socket(type=socket.SOCK_DGRAM)
        self.address = ("127.0.0.1", free_port())
        self.session = time.time_ns()
        self.network = folder / "network.toml"
        self.network.write_text(
            f'[[outputs]]\nto = "127.0.0.1:{self.states.getsockname()[1]}"\nformat = "json"\nrobot = 3\n\n'
            f'[commands]\nbind = "127.0.0.1:{self.address[1]}"\nkey = "{self.KEY}"\n'
        )

    def state(self, **wanted: object) -> dict[str, Any]:
        """The next state with these values; without any, the next one with a pose."""
        until = time.monotonic() + 60
        while time.monotonic() < until:
            state: dict[str, Any] = json.loads(self.states.recv(65535))
            located = wanted or state["pose"] is not None
            if located and all(state[key] == value for key, value in wanted.items()):
                return state
        raise AssertionError(f"no state with {wanted}")

    def datagram(self, sequence: int, boot: int, *, key: str = KEY, **wish: object) -> bytes:
        named = {"boot": boot, "robot": 3} if boot else {}
        head = {"version": 1, "session": self.session, "sequence": sequence, "valid_ms": 100}
        content = json.dumps(head | named | wish).encode()
        return content + hmac.new(key.encode(), content, "sha256").digest()[:16]

    def send(self, datagram: bytes) -> None:
        self.out.sendto(datagram, self.address)

    def close(self) -> None:
        self.states.close()
        self.out.close()


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Program]:
    program = Program(tmp_path)
    yield program
    program.close()


def take_valid(commands: dict[str, Any]) -> int:
    """Number of commands that nothing was wrong with. A machine that delays a thread by 100 ms makes some of them late."""
    late: int = commands["refused"].pop("late", 0)
    return int(commands["accepted"]) + int(commands["overruled"]) + late


FORWARD = {"x": 0.8, "y": 0.0, "theta": 0.0}


def test_remote_commands_drive_and_kick_and_silence_stops_the_wheels(tmp_path: Path, program: Program) -> None:
    sim = hardware(tmp_path / "robot", "--truth", tmp_path / "truth.csv")
    run = start("run", "--robot", tmp_path / "robot", "--network", program.network, "--json")
    boot = program.state()["boot"]
    for sequence in range(50):
        program.send(program.datagram(sequence, boot, drive=FORWARD, needs_pose=True))
        time.sleep(0.03)
    program.send(program.datagram(50, boot, kick={"speed": 5.0}))
    silent = time.monotonic()
    time.sleep(0.5)
    # A replayed command or a command under another key must not drive.
    for sequence in range(51, 61):
        program.send(program.datagram(10, boot, drive=FORWARD))
        program.send(program.datagram(sequence, boot, key="known to nobody", drive=FORWARD))
        time.sleep(0.03)
    time.sleep(0.5)
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    stats = ended(sim)["commands"]
    commands = report["commands"]
    # Without a fresh pose, as on a machine too busy for the simulation, a command that needs one is overruled.
    assert take_valid(commands) == 51
    assert commands["refused"] == {"old": 10, "unsealed": 10}
    # On such a machine a report of the base may come after a command has expired, too.
    assert 10 < commands["obeyed"] <= commands["sent"] <= commands["accepted"]
    assert stats["driving"] > 40 and stats["kicks"] == 1 and stats["too_long"] == 0
    # The last command is valid for 100 ms; the rest is latency of the machine.
    assert stats["last_driving_s"] < silent + 0.25 and stats["stands_last"]
    with (tmp_path / "truth.csv").open() as file:
        truth = [(float(row["stamp_s"]), float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(file)]
    drove = [row[1:] for row in truth if silent - 1.4 < row[0] < silent - 0.1]
    stands = [row[1:] for row in truth if row[0] > silent + 0.45]
    assert math.dist(drove[0], drove[-1]) > 0.5
    assert math.dist(stands[0], stands[-1]) < 0.02


def test_commands_that_waited_while_the_process_was_stopped_neither_drive_nor_kick(tmp_path: Path, program: Program) -> None:
    sim = hardware(tmp_path / "robot", "--truth", tmp_path / "truth.csv")
    run = start("run", "--robot", tmp_path / "robot", "--network", program.network, "--json")
    boot = program.state()["boot"]
    stop(run)
    stopped = time.monotonic()
    for sequence in range(20):
        program.send(program.datagram(sequence, boot, drive=FORWARD))
        program.send(program.datagram(100 + sequence, boot, kick={"speed": 5.0}, drive=FORWARD))
    # Datagrams arrive in order: when this one is refused, all before it were read.
    program.send(program.datagram(200, boot, key="known to nobody"))
    # Ten times as long as a command is valid.
    time.sleep(1.0)
    run.send_signal(signal.SIGCONT)
    fault = program.state(command_fault="not under our key")
    assert fault["boot"] == boot
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    stats = ended(sim)["commands"]
    assert report["commands"]["refused"] == {"late": 21, "old": 19, "unsealed": 1} and report["commands"]["accepted"] == 0
    assert stats["driving"] == 0 and stats["kicks"] == 0, stats
    with (tmp_path / "truth.csv").open() as file:
        truth = [(float(row["x_m"]), float(row["y_m"])) for row in csv.DictReader(file) if float(row["stamp_s"]) > stopped]
    assert math.dist(truth[0], truth[-1]) < 0.005


def test_command_recorded_before_a_restart_or_without_the_boot_number_has_no_effect(tmp_path: Path, program: Program) -> None:
    sim = hardware(tmp_path / "robot")
    arguments = ("run", "--robot", tmp_path / "robot", "--network", program.network, "--json")
    run = start(*arguments)
    boot = program.state()["boot"]
    captured = [program.datagram(sequence, boot, drive=FORWARD) for sequence in range(5)]
    for datagram in captured:
        program.send(datagram)
        program.state()
    run.send_signal(signal.SIGTERM)
    commands = ended(run)["commands"]
    assert take_valid(commands) == 5 and commands["refused"] == {}
    run = start(*arguments)
    while program.state()["boot"] == boot:
        pass
    for datagram in captured:
        program.send(datagram)
    again = program.state(command_fault="for another start of this robot: echo `boot` from its present state output")
    assert again["boot"] != boot
    # A client of an earlier version does not know the boot number.
    program.send(program.datagram(90, 0, drive=FORWARD))
    program.state(command_fault="without `boot` and `robot`: with a key, echo both from the robot's state output")
    program.send(program.datagram(91, again["boot"], robot=4, drive=FORWARD))
    program.state(command_fault="for another robot")
    run.send_signal(signal.SIGTERM)
    out, err = run.communicate(timeout=60)
    commands = json.loads(out)["commands"]
    assert commands["refused"] == {"boot": 5, "unbound": 1, "robot": 1} and commands["accepted"] == 0
    assert err.count("echo both from the robot's state output") == 1, err
    sim.send_signal(signal.SIGTERM)
    assert ended(sim)["commands"]["too_long"] == 0


def test_captured_sessions_replayed_in_turn_do_not_drive(tmp_path: Path, program: Program) -> None:
    sim = hardware(tmp_path / "robot")
    run = start("run", "--robot", tmp_path / "robot", "--network", program.network, "--json")
    boot = program.state()["boot"]
    captured = []
    for session in range(2):
        program.session += session
        captured.append([program.datagram(sequence, boot, drive=FORWARD) for sequence in range(5)])
        for datagram in captured[-1]:
            program.send(datagram)
            program.state()
    # The sender is silent for longer than the silence after which a lower session number is accepted.
    time.sleep(1.2)
    faults = [
        "another sender took over with a higher session. Start again with a higher one, "
        "or without a key wait until that sender is silent."
        f" It is 127.0.0.1:{program.out.getsockname()[1]}",
        "received before, or older than the latest message",
    ]
    for turn in range(4):
        for datagram in captured[turn % 2]:
            program.send(datagram)
        program.state(command_fault=faults[turn % 2])
        time.sleep(1.2)
    run.send_signal(signal.SIGTERM)
    commands = ended(run)["commands"]
    assert take_valid(commands) == 10 and commands["refused"] == {"old": 10, "superseded": 10}, commands
    sim.send_signal(signal.SIGTERM)
    ended(sim)


def test_without_a_base_no_command_counts_as_obeyed(tmp_path: Path, program: Program) -> None:
    sim = hardware(tmp_path / "robot")
    (tmp_path / "robot" / "base").unlink()
    run = start("run", "--robot", tmp_path / "robot", "--network", program.network, "--json")
    boot = program.state()["boot"]
    for sequence in range(10):
        program.send(program.datagram(sequence, boot, drive=FORWARD))
        program.state()
    run.send_signal(signal.SIGTERM)
    commands = ended(run)["commands"]
    assert take_valid(commands) == 10 and commands["sent"] == 0 and commands["obeyed"] == 0
    assert commands["accepted"] > 0
    sim.send_signal(signal.SIGTERM)
    ended(sim)


def test_command_on_a_state_outside_the_window_or_for_another_boot_number_is_refused(tmp_path: Path, program: Program) -> None:
    sim = hardware(tmp_path / "robot")
    run = start("run", "--robot", tmp_path / "robot", "--network", program.network, "--json")
    first = program.state()
    boot = first["boot"]
    # A state that is a second old, ten minutes in the future, and of the wall clock.
    late = "too late: expired before it was read, or based on an old state"
    future = "`state_ns` is in the future of this robot's clock: echo `stamp_ns` of its state output"
    for sequence, (state_ns, fault) in enumerate(
        [
            (first["stamp_ns"] - 10**9, late),
            (first["stamp_ns"] + 600 * 10**9, future),
            (time.time_ns(), future),
            (-(2**63), late),
        ]
    ):
        program.send(program.datagram(sequence, boot, state_ns=state_ns, drive=FORWARD, kick={"speed": 5.0}))
        program.state(command_fault=fault)
    for sequence, nonce in enumerate([boot + 1, boot - 1, 1, 2**53], start=10):
        program.send(program.datagram(sequence, nonce, drive=FORWARD, kick={"speed": 5.0}))
        program.state(command_fault="for another start of this robot: echo `boot` from its present state output")
    # What was refused has not used up its sequence number.
    for sequence in range(10):
        program.send(program.datagram(sequence, boot, state_ns=program.state()["stamp_ns"], drive=FORWARD))
        program.state()
    run.send_signal(signal.SIGTERM)
    commands = ended(run)["commands"]
    assert commands["refused"]["late"] >= 2, commands
    assert take_valid(commands) == 2 + 10 and commands["accepted"] + commands["overruled"] > 0, commands
    assert commands["refused"] == {"future": 2, "boot": 4}, commands
    sim.send_signal(signal.SIGTERM)
    stats = ended(sim)["commands"]
    assert stats["kicks"] == 0 and stats["stands_last"], stats


@pytest.mark.parametrize(
    ("network", "problem"),
    [
        ('[team]\ninterface = "192.0.2.7"\n', "set a key"),
        ('[team]\ninterface = "0.0.0.0"\n', "set a key"),
        ('[commands]\nbind = "0.0.0.0:7071"\n', "set a key"),
        ('[commands]\nkey = "known to both sides"\n', "Add [[outputs]]"),
        ('[stream]\nbind = "0.0.0.0"\ntuning = true\n', "set a key"),
    ],
)
def test_network_that_nobody_could_trust_is_refused_in_one_line(tmp_path: Path, network: str, problem: str) -> None:
    sim = hardware(tmp_path / "robot")
    path = tmp_path / "network.toml"
    path.write_text(network)
    run = start("run", "--robot", tmp_path / "robot", "--network", path, "--duration", 1)
    _, err = run.communicate(timeout=60)
    sim.send_signal(signal.SIGTERM)
    assert ended(sim)["commands"]["driving"] == 0
    assert run.returncode == 1 and len(err.splitlines()) == 1 and str(path) in err and problem in err, err


def test_state_names_what_keeps_accepted_commands_from_the_wheels(tmp_path: Path, program: Program) -> None:
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nkind = "base-silent"\nat = 0.0\nfor = 6.0\n')
    sim = hardware(tmp_path / "robot", "--faults", faults)
    terminal, end = pty.openpty()
    arguments = ["--robot", tmp_path / "robot", "--network", program.network, "--teleop", "--json"]
    run = start("run", *arguments, preexec_fn=in_own_terminal(end))

    def state_with(fault: str) -> dict[str, Any]:
        until = time.monotonic() + 60
        while time.monotonic() < until:
            state = program.state(robot=3)
            program.send(program.datagram(time.monotonic_ns(), state["boot"], drive=FORWARD))
            if fault in state["command_fault"] and bool(fault) == bool(state["command_fault"]):
                return state
        raise AssertionError(f"no state with {fault!r}: {state['command_fault']!r}")

    state_with("no usable base")
    state_with("")
    # Space stops the robot that a program drives, and keeps it stopped.
    os.write(terminal, b" ")
    state_with("a person has stopped the robot")
    stopped = time.monotonic()
    while time.monotonic() < stopped + 1.5:
        state_with("a person has stopped the robot")
    os.write(terminal, b"r")
    state_with("")
    run.send_signal(signal.SIGTERM)
    commands = ended(run)["commands"]
    os.close(terminal)
    os.close(end)
    assert commands["accepted"] > 0 and commands["overruled"] > 10
    sim.send_signal(signal.SIGTERM)
    ended(sim)
