"""Does the live stream survive what strangers do to it? Its connections are limited in number, time and size."""

import base64
import contextlib
import json
import os
import resource
import signal
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

import pytest

from test_robot import StateOutput, ended, free_port, hardware, start, states  # noqa: F401

TIMEOUT_S = 60.0
ABOUT = "/about"


class Viewer:
    """A WebSocket client (RFC 6455), as small as the tests need."""

    opened: ClassVar[list[socket.socket]] = []

    def __init__(self, port: int, origin: str | None = None) -> None:
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=TIMEOUT_S)
        self.opened.append(self.socket)
        lines = ["GET / HTTP/1.1", f"Host: 127.0.0.1:{port}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Version: 13", "Sec-WebSocket-Protocol: foxglove.sdk.v1"]
        lines += [f"Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}"]
        lines += [f"Origin: {origin}"] if origin else []
        self.socket.sendall("\r\n".join([*lines, "", ""]).encode())
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            byte = self.socket.recv(1)
            if not byte:
                break
            head += byte
        self.accepted = head.startswith(b"HTTP/1.1 101")

    def send(self, payload: bytes, opcode: int = 1, final: bool = True) -> None:
        length = len(payload)
        header = bytes([opcode | (0x80 if final else 0)])
        if length < 126:
            header += bytes([0x80 | length])
        elif length < 65536:
            header += struct.pack(">BH", 0x80 | 126, length)
        else:
            header += struct.pack(">BQ", 0x80 | 127, length)
        self.socket.sendall(header + bytes(4) + payload)

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            part = self.socket.recv(count - len(data))
            if not part:
                raise ConnectionError("closed")
            data += part
        return data

    def receive(self) -> tuple[int, bytes]:
        """The next frame: opcode and payload."""
        first, second = self._exactly(2)
        length = second & 0x7F
        if length == 126:
            (length,) = struct.unpack(">H", self._exactly(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self._exactly(8))
        return first & 0x0F, self._exactly(length)

    def channels(self) -> dict[str, int]:
        while True:
            opcode, payload = self.receive()
            if opcode == 1 and (message := json.loads(payload))["op"] == "advertise":
                return {channel["topic"]: channel["id"] for channel in message["channels"]}

    def subscribe(self, *ids: int) -> None:
        subscriptions = [{"id": one, "channelId": one} for one in ids]
        self.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode())

    def unsubscribe(self, *ids: int) -> None:
        self.send(json.dumps({"op": "unsubscribe", "subscriptionIds": list(ids)}).encode())

    def data(self) -> int:
        """The subscription of the next message."""
        while True:
            opcode, payload = self.receive()
            if opcode == 2 and payload[0] == 1:
                return int.from_bytes(payload[1:5], "little")

    @classmethod
    def close_all(cls) -> None:
        while cls.opened:
            cls.opened.pop().close()

    def is_closed(self) -> bool:
        """Waits until the other side closes."""
        try:
            while self.socket.recv(65536):
                pass
        except ConnectionError:
            pass
        return True


@pytest.fixture
def stream(tmp_path: Path, states: StateOutput) -> Iterator[int]:  # noqa: F811
    """The port of the stream of a running robot. Afterwards the robot still runs, and says what it rejected."""
    port = free_port()
    sim = hardware(tmp_path / "robot")
    states.network.write_text(states.network.read_text() + f"\n[stream]\nport = {port}\nstall = 1.0\n")
    run = start("run", "--robot", tmp_path / "robot", "--network", states.network, "--json")
    states.wait(3)
    yield port
    Viewer.close_all()
    states.wait(3)
    run.send_signal(signal.SIGTERM)
    assert ended(run)["frames"] > 0
    sim.send_signal(signal.SIGTERM)
    ended(sim)


def listening_ports(pid: int) -> set[int]:
    """The TCP ports on which a process listens."""
    targets = []
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        # The process goes on: a descriptor may be closed meanwhile.
        with contextlib.suppress(FileNotFoundError):
            targets.append(str(descriptor.readlink()))
    inodes = {target.removeprefix("socket:[").removesuffix("]") for target in targets}
    rows = [line.split() for line in Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]]
    return {int(row[1].split(":")[1], 16) for row in rows if row[3] == "0A" and row[9] in inodes}


def admitted(port: int, origin: str | None = None) -> Viewer:
    """A viewer with a place: those of closed connections are free when their threads have seen the end."""
    until = time.monotonic() + TIMEOUT_S
    while True:
        with contextlib.suppress(ConnectionError):
            viewer = Viewer(port, origin)
            if viewer.accepted:
                return viewer
        assert time.monotonic() < until, "no place for a viewer"
        time.sleep(0.05)


def header_comes(port: int) -> bool:
    viewer = admitted(port)
    channels = viewer.channels()
    viewer.subscribe(channels[ABOUT])
    return viewer.data() == channels[ABOUT]


def test_stream_survives_floods_long_messages_slow_requests_and_strange_pages(stream: int) -> None:
    # Far more connections than there is place for, all open at once: more than the usual limit of descriptors.
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, min(hard, 2048)), hard))
    with contextlib.ExitStack() as crowd:
        slow = crowd.enter_context(socket.create_connection(("127.0.0.1", stream), timeout=TIMEOUT_S))
        slow.sendall(b"GET / HTTP/1.1\r\n")
        for _ in range(1000):
            crowd.enter_context(socket.create_connection(("127.0.0.1", stream), timeout=TIMEOUT_S))
        # The first ones have a place until their time for a request is over; the others are closed at once.
        with contextlib.suppress(ConnectionResetError):
            assert slow.recv(1) == b"", "a slow request is closed"
    assert header_comes(stream)
    # A message in fragments that never ends.
    endless = admitted(stream)
    with pytest.raises(ConnectionError):
        for _ in range(1000):
            endless.send(bytes(60_000), opcode=2 if _ == 0 else 0, final=False)
    page = Viewer(stream, origin="https://evil.example")
    assert not page.accepted
    admitted(stream, origin="http://localhost:8080")
    assert header_comes(stream)


def test_server_that_ended_for_lack_of_descriptors_is_started_again(tmp_path: Path, states: StateOutput) -> None:  # noqa: F811
    port = free_port()
    sim = hardware(tmp_path / "robot")
    states.network.write_text(states.network.read_text() + f"\n[stream]\nport = {port}\n")
    run = start("run", "--robot", tmp_path / "robot", "--network", states.network, "--json")
    states.wait(3)
    assert header_comes(port)
    Viewer.close_all()
    (inner,) = listening_ports(run.pid) - {port}
    soft, hard = resource.prlimit(run.pid, resource.RLIMIT_NOFILE)
    # The server behind the guard leaves its accept loop at the first error: it has no descriptor for a connection.
    resource.prlimit(run.pid, resource.RLIMIT_NOFILE, (3, hard))
    victim = socket.socket()
    with contextlib.suppress(ConnectionError):
        victim.connect(("127.0.0.1", inner))
    until = time.monotonic() + TIMEOUT_S
    while inner in listening_ports(run.pid):
        assert time.monotonic() < until
        states.wait(1)
    resource.prlimit(run.pid, resource.RLIMIT_NOFILE, (soft, hard))
    victim.close()
    assert header_comes(port)
    Viewer.close_all()
    states.wait(3)
    run.send_signal(signal.SIGTERM)
    _, err = run.communicate(timeout=TIMEOUT_S)
    assert run.returncode == 0
    assert "the stream's server was gone and has been started again" in err, err
    sim.send_signal(signal.SIGTERM)
    ended(sim)


def test_header_goes_only_to_the_viewer_that_subscribes(stream: int) -> None:
    first, second = Viewer(stream), Viewer(stream)
    channels = first.channels()
    cycle, about = channels["/cycle"], channels[ABOUT]
    first.subscribe(about, cycle)
    while first.data() != about:
        pass
    second.channels()
    for _ in range(20):
        second.subscribe(about)
        while second.data() != about:
            pass
        second.unsubscribe(about)
    assert [first.data() for _ in range(5)] == [cycle] * 5


def test_viewer_that_takes_nothing_is_dropped(stream: int) -> None:
    stalled = Viewer(stream)
    stalled.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    channels = stalled.channels()
    stalled.subscribe(*channels.values())
    # A second viewer is served meanwhile, until the first one is dropped.
    other = Viewer(stream)
    other.channels()
    other.subscribe(channels["/cycle"])
    for _ in range(120):
        assert other.data() == channels["/cycle"]
    assert stalled.is_closed()
