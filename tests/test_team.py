"""Do team messages of a stalled process and of forged senders do harm? At the level of the process.

The messages are encoded here by hand, from docs/network.proto alone. Multicast stays in a network namespace of each test's own.
"""

import ctypes
import fcntl
import json
import os
import random
import signal
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from test_robot import StateOutput, ended, hardware, start, states, stop  # noqa: F401

GROUP = "239.255.77.78"
# The clock of the simulated team-mate is that much ahead, nanoseconds.
AHEAD_NS = 1_000_000_000_000


CLONE_NEWNET = 0x4000_0000
SIOCSIFFLAGS = 0x8914
IFF_UP, IFF_MULTICAST = 0x1, 0x1000


@pytest.fixture(autouse=True)
def own_network() -> Iterator[None]:
    """A network namespace in which there is nothing but a loopback; processes that the test starts inherit it."""
    before = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNET) != 0:
        os.close(before)
        pytest.skip(f"no network namespace: {os.strerror(ctypes.get_errno())} (expected root)")
    try:
        with socket.socket(type=socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sH14x", b"lo", IFF_UP | IFF_MULTICAST))
        yield
    finally:
        libc.setns(before, CLONE_NEWNET)
        os.close(before)


def varint(value: int) -> bytes:
    encoded = b""
    while value >= 0x80:
        encoded += bytes([value & 0x7F | 0x80])
        value >>= 7
    return encoded + bytes([value])


def number(field: int, value: int) -> bytes:
    return varint(field << 3) + varint(value)


def signed(field: int, value: int) -> bytes:
    # The generated schema has int64 on the wire for sint64 fields of the team: zigzag.
    return number(field, (value << 1) ^ (value >> 63))


def fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Numbers and values of the fields; fixed-size values are left out."""
    place = 0

    def next_varint() -> int:
        nonlocal place
        value, shift = 0, 0
        while True:
            byte = message[place]
            place += 1
            value |= (byte & 0x7F) << shift
            if byte < 0x80:
                return value
            shift += 7

    while place < len(message):
        tag = next_varint()
        match tag & 7:
            case 0:
                yield tag >> 3, next_varint()
            case 2:
                length = next_varint()
                yield tag >> 3, message[place : place + length]
                place += length
            case 1:
                place += 8
            case 5:
                place += 4


class Team:
    """A multicast group on the loopback, in which this process sends as any robot."""

    def __init__(self, network: Path) -> None:
        # The address of the group is shared by all tests of the machine, so the port decides.
        self.port = random.randrange(15_000, 32_000)
        loopback = socket.inet_aton("127.0.0.1")
        self.socket = socket.socket(type=socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind((GROUP, self.port))
        self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + loopback)
        self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, loopback)
        self.socket.settimeout(60)
        self.session = time.time_ns()
        team = f'\n[team]\ngroup = "{GROUP}:{self.port}"\nrobot = 1\nmembers = [1, 2, 3]\n'
        network.write_text(network.read_text() + team)

    def send(self, robot: int, sequence: int, *, sent_ns: int | None = None, echo: bytes = b"") -> None:
        now = time.monotonic_ns() + AHEAD_NS if sent_ns is None else sent_ns
        pose = b"".join(struct.pack("<Bf", field << 3 | 5, value) for field, value in ((1, 1.0), (2, 1.0), (3, 0.0)))
        pose += varint(4 << 3 | 2) + varint(12) + struct.pack("<3f", 0.1, 0.1, 0.1)
        content = number(1, 1) + number(2, 1) + number(3, robot) + number(4, self.session) + number(5, sequence)
        content += signed(6, now) + signed(7, now) + echo + varint(9 << 3 | 2) + varint(len(pose)) + pose
        self.socket.sendto(content, (GROUP, self.port))

    def stamp_of_robot_1(self) -> int:
        """Time at which robot 1 sent its next message, by its own clock."""
        until = time.monotonic() + 60
        while time.monotonic() < until:
            found = dict(fields(self.socket.recv(65535)))
            if found.get(3) == 1 and isinstance(sent := found[6], int):
                return (sent >> 1) ^ -(sent & 1)
        raise AssertionError("no message of robot 1")

    def received_by_robot_1(self) -> set[int]:
        """The robots whose messages the next message of robot 1 echoes."""
        until = time.monotonic() + 60
        while time.monotonic() < until:
            found = list(fields(self.socket.recv(65535)))
            if (3, 1) in found:
                echoes = [dict(fields(value)) for field, value in found if field == 8 and isinstance(value, bytes)]
                return {robot for echo in echoes if isinstance(robot := echo.get(1), int)}
        raise AssertionError("no message of robot 1")

    def close(self) -> None:
        self.socket.close()


@pytest.fixture
def team(states: StateOutput) -> Iterator[Team]:  # noqa: F811
    group = Team(states.network)
    yield group
    group.close()


def test_what_waited_while_the_process_was_stopped_keeps_the_time_of_its_arrival(
    tmp_path: Path,
    states: StateOutput,  # noqa: F811
    team: Team,
) -> None:
    sim = hardware(tmp_path / "robot")
    run = start("run", "--robot", tmp_path / "robot", "--network", states.network, "--json")
    states.wait(3)
    sequence = 0
    while 2 not in team.received_by_robot_1():
        sequence += 1
        team.send(2, sequence)
    stop(run)
    for _ in range(10):
        sequence += 1
        team.send(2, sequence)
    time.sleep(3.0)
    run.send_signal(signal.SIGCONT)
    states.wait(10)
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
    # Messages taken as new when they were read would shift the clock of the team-mate by the three seconds.
    (mate,) = report["team"]
    assert mate["robot"] == 2
    assert abs(mate["clock_offset_ns"] + AHEAD_NS) < 1e9, mate
    # The serial lines have no stamps of the kernel: what waited in them is discarded, and the log says so.
    paused = {change["device"] for change in report["changes"] if "this program was paused" in (change["reason"] or "")}
    assert {"base", "imu"} <= paused, report["changes"]


def test_forged_senders_do_not_keep_a_team_mate_out(tmp_path: Path, states: StateOutput, team: Team) -> None:  # noqa: F811
    sim = hardware(tmp_path / "robot")
    run = start("run", "--robot", tmp_path / "robot", "--network", states.network, "--json")
    states.wait(3)
    sequence = 0

    def forge() -> None:
        nonlocal sequence
        sequence += 1
        for robot in range(100, 140):
            team.send(robot, sequence)

    # Every place is taken by a number that is not of the team.
    while len(team.received_by_robot_1() - {1, 2, 3}) < 16:
        forge()
    # They go on, but a team-mate gets a place, and keeps it.
    while 2 not in team.received_by_robot_1():
        forge()
        team.send(2, sequence)
    for _ in range(5):
        forge()
        assert 2 in team.received_by_robot_1()
    # When they are silent they age out, and another number can take a place.
    while 200 not in team.received_by_robot_1():
        sequence += 1
        team.send(200, sequence)
        team.send(2, sequence)
    # A message of another version is named with its sender, once.
    for _ in range(5):
        team.socket.sendto(number(1, 9) + number(2, 1) + number(3, 3), (GROUP, team.port))
    states.wait(3)
    run.send_signal(signal.SIGTERM)
    out, err = run.communicate(timeout=60)
    report = json.loads(out)
    assert 2 in {mate["robot"] for mate in report["team"]}
    counts = report["team_messages"]
    assert counts["received"] > 16 and counts["refused"]["full"] > 0 and counts["refused"]["version"] == 5, counts
    lines = [line for line in err.splitlines() if "[team] a message of" in line]
    assert len(lines) == 2 and all(f"127.0.0.1:{team.port} is rejected" in line for line in lines), err
    assert "no place" in lines[0] and "of another version" in lines[1], err
    sim.send_signal(signal.SIGTERM)
    ended(sim)


def test_stated_uncertainty_covers_the_true_clock_offset(tmp_path: Path, states: StateOutput, team: Team) -> None:  # noqa: F811
    sim = hardware(tmp_path / "robot")
    run = start("run", "--robot", tmp_path / "robot", "--network", states.network, "--json")
    states.wait(3)
    began_ns = time.monotonic_ns()
    # Its messages need that long to robot 1, and nothing back: the worst that a symmetric estimate can meet.
    delay_s = 0.04

    def clock_of_robot_2(own_ns: int) -> int:
        """A clock that is ahead and runs 400 ppm fast."""
        return own_ns + AHEAD_NS + (own_ns - began_ns) * 400 // 1_000_000

    for sequence in range(1, 31):
        echoed_ns = team.stamp_of_robot_1()
        arrived_ns = clock_of_robot_2(time.monotonic_ns())
        time.sleep(0.005)
        sent_ns = clock_of_robot_2(time.monotonic_ns())
        echo = number(1, 1) + signed(2, echoed_ns) + signed(3, sent_ns - arrived_ns)
        time.sleep(delay_s)
        team.send(2, sequence, sent_ns=sent_ns, echo=varint(8 << 3 | 2) + varint(len(echo)) + echo)
    states.wait(3)
    interrupted_ns = time.monotonic_ns()
    run.send_signal(signal.SIGTERM)
    (mate,) = ended(run)["team"]
    stated_ns, uncertainty_ns = mate["clock_offset_ns"], mate["clock_uncertainty_ns"]
    errors = [abs(stated_ns + clock_of_robot_2(at) - at) for at in (interrupted_ns, time.monotonic_ns())]
    # The report was made between the two.
    assert min(errors) <= uncertainty_ns, (mate, errors)
    # Neither is the error small here, nor is the bound far above the half of the delay.
    assert min(errors) > 0.4 * delay_s * 1e9 and uncertainty_ns < 3 * delay_s * 1e9, (mate, errors)
    sim.send_signal(signal.SIGTERM)
    ended(sim)
