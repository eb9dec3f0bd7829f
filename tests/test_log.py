"""Logs of `mirrorball sim --record`, read by other tools: Python's mcap and Rerun."""

import csv
import importlib.util
import os
import runpy
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "target" / "release" / "mirrorball"
SCENARIO = ROOT / "config" / "scenarios" / "demo.toml"

TOPICS = {
    "/camera/image": "foxglove.CompressedImage",
    "/camera/annotations": "foxglove.ImageAnnotations",
    "/vision/line_points": "foxglove.PointCloud",
    "/vision/robots": "mirrorball.Robots",
    "/vision/sensors": "mirrorball.Sensors",
    "/odometry": "mirrorball.Odometry",
    "/imu": "mirrorball.Imu",
    "/compass": "mirrorball.Compass",
    "/pose": "foxglove.PoseInFrame",
    "/truth/pose": "foxglove.PoseInFrame",
    "/tf": "foxglove.FrameTransforms",
    "/field/lines": "foxglove.PointCloud",
    "/field/scene": "foxglove.SceneUpdate",
    "/cycle": "mirrorball.Cycle",
}


def run(*arguments: object) -> str:
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "game.mcap"
    run("sim", SCENARIO, "--seed", 3, "--duration", 2, "--record", path)
    return path


def messages(path: Path, topic: str) -> list[Any]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [found.decoded_message for found in reader.iter_decoded_messages(topics=[topic])]


def test_every_topic_has_its_schema_and_messages(log: Path) -> None:
    with log.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None and summary.statistics is not None
    found = {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}
    assert TOPICS.items() <= found.items()
    assert all(count > 0 for count in summary.statistics.channel_message_counts.values())
    names = {index.name for index in summary.attachment_indexes}
    assert {"robot.toml", "field.toml", "map.npz"} <= names
    assert [index.name for index in summary.metadata_indexes] == ["mirrorball"]


def test_cycle_message_matches_individual_topics(log: Path) -> None:
    cycles = messages(log, "/cycle")
    assert len(cycles) >= 50
    assert [cycle.index for cycle in cycles] == list(range(len(cycles)))
    odometry = messages(log, "/odometry")
    assert [(one.stamp_ns, one.dx) for cycle in cycles for one in cycle.odometry] == [
        (one.stamp_ns, one.dx) for one in odometry
    ]
    tracked = [cycle.estimate.pose for cycle in cycles if cycle.estimate.HasField("pose")]
    poses = messages(log, "/pose")
    assert [pose.x for pose in tracked] == [pose.pose.position.x for pose in poses]
    clouds = messages(log, "/vision/line_points")
    for cycle, cloud in zip(cycles, clouds, strict=True):
        rows = list(struct.iter_unpack("<5f", cloud.data))
        assert [row[0] for row in rows] == list(cycle.points.x)


def test_camera_images_are_png_of_480x480(log: Path) -> None:
    for image in messages(log, "/camera/image"):
        assert image.format == "png"
        assert image.data.startswith(b"\x89PNG") and struct.unpack(">II", image.data[16:24]) == (480, 480)


def test_log_verifies_and_exports_to_recording(log: Path, tmp_path: Path) -> None:
    run("replay", log, "--verify")
    run("replay", log, "--export", tmp_path / "recording")
    frames = (tmp_path / "recording" / "frames.csv").read_text().splitlines()
    assert len(frames) == 1 + len(messages(log, "/cycle"))
    run("locate", tmp_path / "recording", "--out", tmp_path / "poses.csv")
    assert len((tmp_path / "poses.csv").read_text().splitlines()) == len(frames)


def test_exported_objects_include_people_and_the_headings_of_robots(tmp_path: Path) -> None:
    people = ROOT / "config" / "scenarios" / "hall_crowded.toml"
    run("sim", people, "--duration", 0.5, "--images", "none", "--record", tmp_path / "hall.mcap")
    run("replay", tmp_path / "hall.mcap", "--export", tmp_path / "recording")
    with (tmp_path / "recording/objects.csv").open() as file:
        rows = list(csv.DictReader(file))
    kinds = Counter(row["kind"] for row in rows)
    assert kinds["person"] > kinds["ball"] > 0 and kinds["robot"] > kinds["ball"]
    assert all(bool(row["heading_rad"]) == (row["kind"] == "robot") for row in rows)


def test_log_of_killed_run_is_recovered_and_verifies(log: Path, tmp_path: Path) -> None:
    cut, whole = tmp_path / "cut.mcap", tmp_path / "whole.mcap"
    arguments: list[str | Path] = [PROGRAM, "sim", SCENARIO, "--seed", "3", "--duration", "600", "--record", cut]
    with subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as running:
        # A simulation's log gets its name when it is complete.
        cut = tmp_path / f"cut.mcap.{running.pid}.part"
        while running.poll() is None and (not cut.exists() or cut.stat().st_size < 3_000_000):
            time.sleep(0.05)
        os.kill(running.pid, signal.SIGKILL)
    run("recover", cut, "--out", whole)
    assert len(messages(whole, "/cycle")) > 3
    run("replay", whole, "--verify")


def test_rerun_shows_each_number_of_its_layout(log: Path, tmp_path: Path) -> None:
    if importlib.util.find_spec("rerun") is None:
        assert os.environ.get("MIRRORBALL_REQUIRE_TOOLS") != "1", "rerun-sdk is required here"
        pytest.skip("rerun-sdk is not installed")
    tool = ROOT / "tools/log_to_rerun"
    subprocess.run([sys.executable, tool, log, tmp_path / "out"], check=True, capture_output=True)
    assert (tmp_path / "out/layout.rbl").stat().st_size > 10_000
    recording = tmp_path / f"out/{log.stem}.rrd"
    program = shutil.which("rerun", path=str(Path(sys.executable).parent)) or "rerun"
    command: list[str | Path] = [program, "rrd", "print", recording]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    for archetype in ("Points3D:positions", "InstancePoses3D:translations", "EncodedImage:blob", "Transform3D:translation"):
        assert archetype in listing
    # A curve whose message or field has another name would stay empty without a word.
    plots = runpy.run_path(str(tool))["PLOTS"]
    for topic, message, fields in plots.values():
        assert f"{topic} - data columns: [mirrorball.{message}:message]" in listing
        assert set(fields) <= set(type(messages(log, topic)[0]).DESCRIPTOR.fields_by_name)
