"""Does the node of ROS 2 exchange messages with another implementation of DDS? With Cyclone DDS, in a network of each test."""

import contextlib
import csv
import ctypes
import fcntl
import json
import math
import os
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from test_robot import OBSERVATION_S, PROGRAM, ended, hardware, start

if os.environ.get("MIRRORBALL_REQUIRE_TOOLS") != "1":
    pytest.importorskip("cyclonedds", reason="Cyclone DDS is not installed (requirements.txt)")

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import ros_types as ros

REQUIRED = os.environ.get("MIRRORBALL_REQUIRE_TOOLS") == "1"
CLONE_NEWNET = 0x4000_0000
SIOCADDRT, SIOCSIFFLAGS = 0x890B, 0x8914
IFF_UP, IFF_MULTICAST = 0x1, 0x1000
RTF_UP = 0x1
CYCLONE = """<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface name="lo" multicast="true"/></Interfaces>
<AllowMulticast>true</AllowMulticast></General></Domain></CycloneDDS>"""
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(200))
BEST_EFFORT = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(200))
LATCHED = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal, Policy.History.KeepLast(1))


def has_node() -> bool:
    """The executable was built with the feature `ros2`."""
    done = subprocess.run([PROGRAM, "run", "--help"], capture_output=True, text=True, check=True)
    return "[ros2]" in done.stdout


pytestmark = pytest.mark.skipif(not REQUIRED and not has_node(), reason="the executable has no node of ROS 2 (--features ros2)")


def set_loopback(flags: int) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sH14x", b"lo", flags))


def route_multicast() -> None:
    """224.0.0.0/4 by the loopback."""

    def address(text: str) -> bytes:
        return struct.pack("HH4s8x", socket.AF_INET, 0, socket.inet_aton(text))

    device = ctypes.create_string_buffer(b"lo")
    route = struct.pack("L", 0) + address("224.0.0.0") + address("0.0.0.0") + address("240.0.0.0")
    route += struct.pack("HhLLhxxxxxxPLLH6x", RTF_UP, 0, 0, 0, 0, ctypes.addressof(device), 0, 0, 0)
    with socket.socket(type=socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SIOCADDRT, route)


STARTED: list[subprocess.Popen[str]] = []
"""Processes that a test has not ended yet."""


@contextlib.contextmanager
def network_namespace() -> Iterator[None]:
    """A network with a loopback that multicasts, for this thread and what it starts. Raises OSError without permission."""
    before = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(CLONE_NEWNET) != 0:
        os.close(before)
        raise OSError(ctypes.get_errno(), f"no network namespace: {os.strerror(ctypes.get_errno())} (expected root)")
    try:
        set_loopback(IFF_UP | IFF_MULTICAST)
        route_multicast()
        yield
    finally:
        # Those of a test that failed.
        for process in STARTED:
            process.kill()
            process.communicate()
        STARTED.clear()
        libc.setns(before, CLONE_NEWNET)
        os.close(before)


@pytest.fixture(autouse=True)
def own_network() -> Iterator[None]:
    """A network of each test."""
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(network_namespace())
        except OSError as error:
            pytest.skip(str(error))
        yield


class Peer:
    """Another program in the domain."""

    def __init__(self) -> None:
        self.domain = Domain(0, CYCLONE)
        self.participant = DomainParticipant(0)
        self.entities: list[Any] = []

    def reader(self, name: str, type_: Any, qos: Qos = RELIABLE) -> DataReader[Any]:
        reader = DataReader(self.participant, Topic(self.participant, name, type_), qos=qos)
        self.entities.append(reader)
        return reader

    def writer(self, name: str, type_: Any, qos: Qos = RELIABLE) -> DataWriter[Any]:
        writer = DataWriter(self.participant, Topic(self.participant, name, type_), qos=qos)
        self.entities.append(writer)
        return writer

    def call(self, service: str, request: Any, response: Any) -> Any:
        """Calls a service; None without an answer. The reply names its request outside of the payload, so one at a time."""
        reader = self.reader(f"rr/{service}Reply", response)
        writer = self.writer(f"rq/{service}Request", type(request))
        assert wait(lambda: writer.get_matched_subscriptions() and reader.get_matched_publications()), service
        # The server may know its side later than this one.
        time.sleep(0.3)
        writer.write(request)
        return first(reader)

    def close(self) -> None:
        self.__dict__.clear()


@pytest.fixture
def peer() -> Iterator[Peer]:
    program = Peer()
    yield program
    program.close()


def wait(condition: Callable[[], Any], seconds: float = 30.0) -> Any:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if found := condition():
            return found
        time.sleep(0.02)
    return None


def take(reader: DataReader[Any]) -> list[Any]:
    """What has arrived, without notices of lost writers."""
    return [sample for sample in reader.take(200) if not isinstance(sample, InvalidSample)]


def first(reader: DataReader[Any], seconds: float = 30.0) -> Any:
    taken = wait(lambda: take(reader), seconds)
    return taken[0] if taken else None


def run_robot(folder: Path, network: str, *more: object) -> tuple[subprocess.Popen[str], subprocess.Popen[str]]:
    """The virtual robot, and a run with this network.toml."""
    sim = hardware(folder / "robot")
    (folder / "network.toml").write_text(network)
    run = start("run", "--robot", folder / "robot", "--network", folder / "network.toml", "--json", *more)
    STARTED.extend([sim, run])
    return sim, run


def finish(sim: subprocess.Popen[str], run: subprocess.Popen[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    time.sleep(OBSERVATION_S)
    sim.send_signal(signal.SIGTERM)
    result = ended(sim)
    STARTED.clear()
    return report, result


def yaw(rotation: ros.Quaternion) -> float:
    return 2.0 * math.atan2(rotation.z, rotation.w)


def test_another_implementation_reads_every_topic(tmp_path: Path, peer: Peer) -> None:
    topics = '[ros2.outputs]\nimage = "image"\ncompressed_image = "image/compressed"\nclock = "/clock"\n'
    sim, run = run_robot(tmp_path, f'[ros2]\nnamespace = "/msl_1"\n{topics}')
    readers = {
        name: peer.reader(f"rt/{name}", type_, qos)
        for name, type_, qos in (
            ("msl_1/odom", ros.Odometry, RELIABLE),
            ("msl_1/pose", ros.PoseWithCovarianceStamped, BEST_EFFORT),
            ("tf", ros.TFMessage, RELIABLE),
            ("tf_static", ros.TFMessage, LATCHED),
            ("msl_1/imu", ros.Imu, BEST_EFFORT),
            ("msl_1/image", ros.Image, RELIABLE),
            ("msl_1/image/compressed", ros.CompressedImage, RELIABLE),
            ("msl_1/line_points", ros.PointCloud2, RELIABLE),
            ("msl_1/markers", ros.MarkerArray, RELIABLE),
            ("msl_1/field", ros.MarkerArray, LATCHED),
            ("msl_1/detections", ros.Detection3DArray, RELIABLE),
            ("diagnostics", ros.DiagnosticArray, RELIABLE),
            ("clock", ros.Clock, BEST_EFFORT),
        )
    }
    received: dict[str, Any] = {}

    def complete() -> bool:
        assert run.poll() is None, run.communicate()
        received.update(
            (name, taken[0]) for name, reader in readers.items() if name not in received and (taken := take(reader))
        )
        return len(received) == len(readers)

    assert wait(complete), readers.keys() - received.keys()
    now = time.time()
    pose, odometry = received["msl_1/pose"], received["msl_1/odom"]
    assert pose.header.frame_id == "map" and abs(pose.header.stamp.sec - now) < 30
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    assert pose.pose.covariance[0] > 0.0 and pose.pose.covariance[35] > 0.0
    image = received["msl_1/image"]
    assert image.encoding == "rgb8" and len(image.data) == image.height * image.step
    assert bytes(received["msl_1/image/compressed"].data[:2]) == b"\xff\xd8"
    assert received["msl_1/imu"].linear_acceleration.z == pytest.approx(9.8, abs=1.0)
    assert received["tf_static"].transforms[0].child_frame_id == "camera"
    assert len(received["msl_1/field"].markers[0].points) > 20
    cloud = received["msl_1/line_points"]
    assert [one.name for one in cloud.fields] == ["x", "y", "z", "std_radial", "std_tangential"]
    assert len(cloud.data) == cloud.width * cloud.point_step
    # Transforms of one time compose to the pose.
    poses: dict[tuple[int, int], Any] = {}
    outer: dict[tuple[int, int], Any] = {}
    inner: list[Any] = []

    def composed() -> bool:
        for message in take(readers["msl_1/pose"]):
            poses[message.header.stamp.sec, message.header.stamp.nanosec] = message
        for message in take(readers["tf"]):
            for one in message.transforms:
                if one.child_frame_id == "odom":
                    outer[one.header.stamp.sec, one.header.stamp.nanosec] = one
                else:
                    inner.append(one)
        return len(poses.keys() & outer.keys()) > 20

    assert wait(composed)
    for stamp in poses.keys() & outer.keys():
        at = poses[stamp].pose.pose.position
        time_s = stamp[0] + stamp[1] * 1e-9
        near = min(inner, key=lambda one: abs(one.header.stamp.sec + one.header.stamp.nanosec * 1e-9 - time_s))
        place, move = outer[stamp].transform, near.transform.translation
        theta = yaw(place.rotation)
        x = place.translation.x + math.cos(theta) * move.x - math.sin(theta) * move.y
        y = place.translation.y + math.sin(theta) * move.x + math.cos(theta) * move.y
        assert (x, y) == pytest.approx((at.x, at.y), abs=0.03)
    # Devices: each has a state.
    assert wait(lambda: any("camera" in one.name for array in take(readers["diagnostics"]) for one in array.status))
    report, _ = finish(sim, run)
    assert report["ros2"]["published"] > 200 and report["ros2"]["failed"] == 0 and report["ros2"]["cycles_dropped"] == 0


def drive(writer: DataWriter[Any], seconds: float, speed: float = 0.5) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        writer.write(ros.Twist(linear=ros.Vector3(x=speed)))
        time.sleep(0.02)


def drives(writer: DataWriter[Any], odometry: DataReader[Any]) -> bool:
    drive(writer, 0.5)
    return any(abs(message.twist.twist.linear.x) > 0.3 for message in take(odometry))


def speed_of(reader: DataReader[Any]) -> float:
    """The newest velocity of the wheels."""
    time.sleep(0.6)
    take(reader)
    time.sleep(0.15)
    return max(abs(float(message.twist.twist.linear.x)) for message in take(reader))


def test_twists_drive_until_the_sender_is_gone_and_those_of_its_successor_drive_again(tmp_path: Path, peer: Peer) -> None:
    sim, run = run_robot(tmp_path, "[ros2]\naccept_commands = true\nspeed_max = 2.0\n")
    odometry = peer.reader("rt/odom", ros.Odometry)
    writer = peer.writer("rt/cmd_vel", ros.Twist)
    assert wait(lambda: writer.get_matched_subscriptions()) and first(odometry)
    time.sleep(0.5)
    drive(writer, 1.5)
    assert speed_of(odometry) < 0.2, "the wheels stop 100 ms after the last command"
    # Too fast: rejected, and not shortened.
    drive(writer, 0.5, speed=5.0)
    assert speed_of(odometry) < 0.1
    # The other program is killed, or crashes, and another one takes its place.
    drive(writer, 0.5)
    del odometry, writer
    peer.close()
    time.sleep(0.5)
    successor = Peer()
    odometry, writer = successor.reader("rt/odom", ros.Odometry), successor.writer("rt/cmd_vel", ros.Twist)

    assert wait(lambda: drives(writer, odometry))
    stopped = time.monotonic()
    time.sleep(1.0)
    report, virtual = finish(sim, run)
    counts = report["ros2"]
    assert counts["accepted"] > 50 and counts["refused"]["senseless"] > 10
    assert virtual["commands"]["last_driving_s"] < stopped + 0.5 and virtual["commands"]["too_long"] == 0


def test_topics_flow_again_after_an_outage_of_the_network(tmp_path: Path, peer: Peer) -> None:
    sim, run = run_robot(tmp_path, "[ros2]\naccept_commands = true\n")
    odometry = peer.reader("rt/odom", ros.Odometry)
    field = peer.reader("rt/field", ros.MarkerArray, LATCHED)
    writer = peer.writer("rt/cmd_vel", ros.Twist)
    assert wait(lambda: writer.get_matched_subscriptions()) and first(odometry) and first(field)
    # Longer than the 10 s after which RustDDS forgets a participant.
    set_loopback(0)
    time.sleep(14.0)
    set_loopback(IFF_UP | IFF_MULTICAST)
    route_multicast()
    take(odometry)
    assert first(odometry), "no odometry after the outage"

    assert wait(lambda: drives(writer, odometry)), "no command arrives after the outage"
    assert first(field), "the field's markers are there for those who connect again"
    report, _ = finish(sim, run)
    assert report["ros2"]["accepted"] > 10


def test_commands_and_poses_need_consent(tmp_path: Path, peer: Peer) -> None:
    sim, run = run_robot(tmp_path, "[ros2]\n")
    odometry = peer.reader("rt/odom", ros.Odometry)
    writer = peer.writer("rt/cmd_vel", ros.Twist)
    assert wait(lambda: writer.get_matched_subscriptions()) and first(odometry)
    time.sleep(0.5)
    drive(writer, 0.5)
    value = ros.ParameterValue(type=3, double_value=7.0)
    request = ros.SetParametersRequest([ros.Parameter("vision.scan.range_max", value)])
    answer = peer.call("mirrorball/set_parameters", request, ros.SetParametersResponse)
    assert not answer.results[0].successful and "accept_parameters" in answer.results[0].reason
    report, virtual = finish(sim, run)
    assert report["ros2"]["accepted"] == 0 and report["ros2"]["refused"]["closed"] > 5
    assert virtual["commands"]["driving"] == 0


def test_parameters_and_poses_are_set_and_the_log_repeats_every_bit(tmp_path: Path, peer: Peer) -> None:
    log = tmp_path / "a.mcap"
    sim, run = run_robot(tmp_path, "[ros2]\naccept_parameters = true\naccept_pose = true\n", "--record", log)
    poses = peer.reader("rt/pose", ros.PoseWithCovarianceStamped)
    assert first(poses)
    listed = peer.call("mirrorball/list_parameters", ros.ListParametersRequest([], 0), ros.ListParametersResponse)
    assert "vision.scan.range_max" in listed.result.names
    value = ros.ParameterValue(type=3, double_value=7.5)
    wrong = ros.ParameterValue(type=3, double_value=-1.0)
    request = ros.SetParametersRequest([ros.Parameter("vision.scan.range_max", one) for one in (value, wrong)])
    answer = peer.call("mirrorball/set_parameters", request, ros.SetParametersResponse)
    assert [result.successful for result in answer.results] == [True, False], answer
    names = ros.GetParametersRequest(["vision.scan.range_max"])
    answer = peer.call("mirrorball/get_parameters", names, ros.GetParametersResponse)
    assert answer.values[0].double_value == 7.5
    # The half turn fits the lines as well: without a compass only a given pose decides.
    take(poses)
    before = first(poses).pose.pose
    heading = yaw(before.orientation) + math.pi
    turned = ros.Pose(
        ros.Point(-before.position.x, -before.position.y, 0.0),
        ros.Quaternion(0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2)),
    )
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = covariance[35] = 0.01
    message = ros.PoseWithCovarianceStamped(pose=ros.PoseWithCovariance(turned, covariance))
    initial = peer.writer("rt/initialpose", ros.PoseWithCovarianceStamped)
    assert wait(lambda: initial.get_matched_subscriptions())

    def is_turned() -> bool:
        latest = take(poses)
        return bool(latest) and math.cos(yaw(latest[-1].pose.pose.orientation) - heading) > 0.5

    # The robot may know this writer later than the writer knows the robot.
    written = 0
    while written < 10 and not (written and wait(is_turned, 2.0)):
        initial.write(message)
        written += 1
    assert wait(is_turned, 5.0)
    time.sleep(1.0)
    answer = peer.call("mirrorball/set_pose", ros.SetPoseRequest(message), ros.SetPoseResponse)
    assert answer is not None
    time.sleep(2.0)
    report, _ = finish(sim, run)
    texts = [change["reason"] or "" for change in report["changes"]]
    # One that was written before the robot knew the writer is lost; the service gave another.
    assert 2 <= sum("pose given" in text for text in texts) <= written + 1, texts
    assert any("vision.scan.range_max 9 → 7.5" in text for text in texts), texts
    verified = json.loads(subprocess.run([PROGRAM, "replay", log, "--verify", "--json"], capture_output=True, text=True).stdout)
    assert verified["verified"]["identical"]


def test_localizes_by_the_sensors_of_other_programs(tmp_path: Path, peer: Peer) -> None:
    # A robot without devices: base, inertial unit and camera belong to another program.
    game = tmp_path / "game.mcap"
    scenario = Path(__file__).parents[1] / "config/scenarios/demo.toml"
    ended(start("sim", scenario, "--seed", 5, "--duration", 3, "--record", game, "--json"))
    folder = tmp_path / "recording"
    ended(start("replay", game, "--export", folder, "--json"))
    (folder / "hardware.toml").write_text("")
    inputs = '[ros2.inputs]\nodometry = "/base/odom"\nimu = "/base/imu"\nimage = "/omni/image_raw"\n'
    (tmp_path / "network.toml").write_text(f"[ros2]\n{inputs}")

    def rows(name: str) -> list[dict[str, str]]:
        with (folder / name).open() as file:
            return list(csv.DictReader(file))

    run = start("run", "--robot", folder, "--network", tmp_path / "network.toml", "--json")
    poses = peer.reader("rt/pose", ros.PoseWithCovarianceStamped)
    tf = peer.reader("rt/tf", ros.TFMessage)
    writers = {
        "odometry": peer.writer("rt/base/odom", ros.Odometry),
        "imu": peer.writer("rt/base/imu", ros.Imu),
        "image": peer.writer("rt/omni/image_raw", ros.Image),
    }
    assert wait(lambda: all(writer.get_matched_subscriptions() for writer in writers.values()))
    time.sleep(1.0)
    events: list[tuple[float, str, Any]] = []
    x, y, theta = 5.0, -3.0, 2.0
    for row in rows("odometry.csv"):
        dx, dy = float(row["dx_m"]), float(row["dy_m"])
        x, y = x + math.cos(theta) * dx - math.sin(theta) * dy, y + math.sin(theta) * dx + math.cos(theta) * dy
        theta += float(row["dtheta_rad"])
        rotation = ros.Quaternion(0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))
        odometry = ros.Odometry(child_frame_id="base_link")
        odometry.pose.pose = ros.Pose(ros.Point(x, y, 0.0), rotation)
        events.append((float(row["stamp_s"]), "odometry", odometry))
    for row in rows("imu.csv"):
        force = ros.Vector3(*(float(row[f"a{axis}_m_s2"]) for axis in "xyz"))
        rate = ros.Vector3(*(float(row[f"w{axis}_rad_s"]) for axis in "xyz"))
        events.append((float(row["stamp_s"]), "imu", ros.Imu(linear_acceleration=force, angular_velocity=rate)))
    # Cyclone's Python takes long for many bytes: a mosaic, and every third image.
    for row in rows("frames.csv")[::3]:
        pixels = np.asarray(Image.open(folder / row["file"]).convert("RGB"))
        height, width, _ = pixels.shape
        mosaic = pixels[:, :, 1].copy()
        mosaic[0::2, 0::2], mosaic[1::2, 1::2] = pixels[0::2, 0::2, 0], pixels[1::2, 1::2, 2]
        image = ros.Image(ros.Header(), height, width, "bayer_rggb8", 0, width, mosaic.tobytes())
        events.append((float(row["stamp_s"]), "image", image))
    order = {"imu": 0, "odometry": 1, "image": 2}
    events.sort(key=lambda event: (event[0], order[event[1]]))
    begin = time.time()
    for stamp_s, kind, message in events:
        time.sleep(max(0.0, begin + stamp_s - time.time()))
        sent = begin + stamp_s
        message.header.stamp = ros.Time(int(sent), int(sent % 1.0 * 1e9))
        writers[kind].write(message)
    time.sleep(0.5)
    errors = []
    for message in take(poses):
        stamp = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 - begin
        row = min(rows("truth.csv"), key=lambda row: abs(float(row["stamp_s"]) - stamp))
        if abs(float(row["stamp_s"]) - stamp) > 0.005:
            # Predicted in place of a missing image.
            continue
        at = message.pose.pose.position
        errors.append(math.hypot(at.x - float(row["x_m"]), at.y - float(row["y_m"])))
    children = {one.child_frame_id for message in take(tf) for one in message.transforms}
    run.send_signal(signal.SIGTERM)
    report = ended(run)
    assert report["ros2"]["samples"] > 100, report
    assert len(errors) > 10, (len(errors), report)
    assert sorted(errors)[len(errors) // 2] < 0.05, errors
    # The frame odom belongs to the other program.
    assert children == {"odom"}
