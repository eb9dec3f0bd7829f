"""Damaged files, hostile logs and full disks, at the level of the process."""

import json
import os
import re
import resource
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from mirrorball.log import Log, LogError
from mirrorball.output_file import replacing

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "target" / "release" / "mirrorball"
SCENARIO = ROOT / "config" / "scenarios" / "demo.toml"
SEQUENCE = ROOT / "samples" / "sequence"
# Largest memory of a process that reads a hostile file, bytes. An ordinary replay needs about a hundred megabytes.
MEMORY_MAX = 600e6


def run(*arguments: object, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True, check=False, **options)


def refused(*arguments: object) -> str:
    """Runs a command that must fail with one message and little memory. Returns the message."""
    process = subprocess.Popen([PROGRAM, *map(str, arguments)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    with process.stderr as errors:
        message = errors.read()
    _, status, used = os_wait(process)
    assert status == 1, message
    assert "internal error" not in message
    # A process starts as a copy of this one, whose memory counts too.
    own_memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert used.ru_maxrss * 1024 < max(MEMORY_MAX, 1.05 * own_memory * 1024), f"{used.ru_maxrss} KiB"
    return message


def os_wait(process: subprocess.Popen[str]) -> tuple[int, int, resource.struct_rusage]:
    pid, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return pid, process.returncode, used


def write_log(path: Path, files: dict[str, bytes], messages: list[tuple[str, bytes]], source: Path) -> None:
    """A log with the metadata of another log, and the given files and messages. Its chunks have no checksum."""
    with source.open("rb") as file:
        metadata = next(make_reader(file).iter_metadata()).metadata
    with path.open("wb") as out:
        writer = Writer(out, compression=CompressionType.ZSTD, enable_crcs=False, chunk_size=1 << 30)
        writer.start(profile="mirrorball")
        writer.add_metadata("mirrorball", dict(metadata))
        for name, content in files.items():
            writer.add_attachment(0, 0, name, "", content)
        channels = {topic: writer.register_channel(topic, "protobuf", 0) for topic, _ in messages}
        for number, (topic, data) in enumerate(messages):
            writer.add_message(channels[topic], number, data, number)
        writer.finish()


def write_without_chunks(source: Path, path: Path) -> None:
    """All records of a log, its messages one by one."""
    with source.open("rb") as file, path.open("wb") as out:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        writer = Writer(out, use_chunking=False)
        writer.start(profile="mirrorball")
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, dict(metadata.metadata))
        for each in reader.iter_attachments():
            writer.add_attachment(each.create_time, each.log_time, each.name, each.media_type, each.data)
        schemas = {
            number: writer.register_schema(schema.name, schema.encoding, schema.data)
            for number, schema in summary.schemas.items()
        }
        channels = {
            number: writer.register_channel(each.topic, each.message_encoding, schemas.get(each.schema_id, 0))
            for number, each in summary.channels.items()
        }
        for _, channel, message in reader.iter_messages():
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()


def test_log_without_chunks_is_named_and_recovered(game: Path, tmp_path: Path) -> None:
    log, copy = tmp_path / "single.mcap", tmp_path / "copy.mcap"
    write_without_chunks(game, log)
    with pytest.raises(LogError, match=r"not in chunks.*recover"):
        Log(log)
    assert run("recover", log, "--out", copy).returncode == 0
    counts = [Log(path).message_counts["/cycle"] for path in (game, copy)]
    assert counts[0] == counts[1] > 0


@pytest.fixture(scope="module")
def log_files(game: Path) -> dict[str, bytes]:
    with game.open("rb") as file:
        return {each.name: each.data for each in make_reader(file).iter_attachments()}


def test_chunk_that_unpacks_to_gigabytes_is_refused(game: Path, log_files: dict[str, bytes], tmp_path: Path) -> None:
    bomb = tmp_path / "bomb.mcap"
    write_log(bomb, log_files, [("/cycle", bytes(64 << 20))] * 8, game)
    assert bomb.stat().st_size < 5e6
    for command in (["replay", bomb], ["replay", bomb, "--export", tmp_path / "export"]):
        assert "unpacks to" in refused(*command)
    assert "no readable message" in refused("recover", bomb, "--out", tmp_path / "whole.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["bomb.mcap"]


def test_message_of_millions_of_empty_reports_is_refused(game: Path, log_files: dict[str, bytes], tmp_path: Path) -> None:
    bomb = tmp_path / "bomb.mcap"
    # Field 16 of a cycle, a report without content.
    write_log(bomb, log_files, [("/cycle", b"\x82\x01\x00" * 2_500_000)], game)
    assert "fields" in refused("replay", bomb)


@pytest.mark.parametrize("target", ["/etc/passwd", "/dev/zero", "../secret.toml"])
def test_log_cannot_name_a_file_outside_itself(game: Path, log_files: dict[str, bytes], tmp_path: Path, target: str) -> None:
    log = tmp_path / "game.mcap"
    robot = log_files["robot.toml"].decode().replace('field = "field.toml"', f'field = "{target}"')
    assert target in robot
    write_log(log, {**log_files, "robot.toml": robot.encode()}, [], game)
    message = refused("replay", log)
    assert f'field = "{target}" (expected the name of a file in the log)' in message
    assert "root:" not in message


def test_map_of_another_size_is_refused_before_it_is_read(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(SEQUENCE, folder)
    huge = np.zeros((6000, 10000), np.float32)
    np.savez_compressed(tmp_path / "map.npz", x_m=huge, y_m=huge[:1])
    with (folder / "robot.toml").open("a") as robot:
        robot.write('\n[map]\nfile = "../map.npz"\n')
    assert "wrong shape of x_m: 6000 × 10000" in refused("locate", folder)


def recording_with(folder: Path, name: str, setting: str) -> Path:
    """A copy of the sample, with a top-level setting in its robot.toml that names a file."""
    shutil.copytree(SEQUENCE, folder)
    robot = folder / "robot.toml"
    robot.write_text(setting.format(name) + "\n" + robot.read_text())
    return folder


def limit_address_space() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))


@pytest.mark.parametrize("kind", ["fifo", "zero", "socket"])
@pytest.mark.parametrize(
    "setting", ['include = ["{}"]', 'colours = "{}"', 'mask = "{}"', 'labels = "{}"', "mirror.csv", "odometry.csv"]
)
def test_input_that_is_no_regular_file_is_refused_by_name(tmp_path: Path, setting: str, kind: str) -> None:
    name = setting if setting.endswith(".csv") else "special"
    folder = recording_with(tmp_path / "robot", name, "" if setting == name else setting)
    special = folder / name
    special.unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX)
    if kind == "fifo":
        os.mkfifo(special)
    elif kind == "zero":
        special.symlink_to("/dev/zero")
    else:
        listener.bind(str(special))
    # Each of them was read without an end, or waited for.
    done = run("locate", folder, "--out", tmp_path / "poses.csv", timeout=60, preexec_fn=limit_address_space)
    listener.close()
    assert done.returncode == 1, done.stderr
    assert str(special) in done.stderr and "not a regular file" in done.stderr
    assert not (tmp_path / "poses.csv").exists()


@pytest.mark.parametrize("command", [["replay"], ["recover", "--out", "whole.mcap"], ["report", "--out", "page"], ["doctor"]])
def test_log_that_is_a_pipe_is_refused(tmp_path: Path, command: list[str]) -> None:
    log = tmp_path / "game.mcap"
    os.mkfifo(log)
    done = run(command[0], log, *command[1:], timeout=60, cwd=tmp_path)
    assert done.returncode in (1, 2) and str(log) in done.stderr, done.stderr


def test_settings_are_read_from_standard_input_and_the_empty_device(tmp_path: Path) -> None:
    def poses(config: str, **options: Any) -> str:
        out = tmp_path / "poses.csv"
        done = run("locate", SEQUENCE, "--config", config, "--out", out, **options)
        assert done.returncode == 0, done.stderr
        return out.read_text()

    assert poses("/dev/null") == poses("/dev/stdin", input="")
    done = run("locate", SEQUENCE, "--config", "/dev/stdin", "--out", tmp_path / "poses.csv", input="[vision]\nnone = 1\n")
    assert done.returncode == 1 and "/dev/stdin" in done.stderr and "none" in done.stderr


def test_record_without_an_end_is_refused(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(SEQUENCE, folder)
    with (folder / "odometry.csv").open("a") as table:
        table.write('9.0,"' + "9.0,0,0,0\n" * 300_000)
    message = refused("locate", folder, "--out", tmp_path / "poses.csv")
    assert "odometry.csv: line" in message and "a record is longer than 1048576 bytes" in message


def test_log_that_ends_within_its_set_up_says_so(game: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    start = game.read_bytes().index(b"robot.toml")
    cut.write_bytes(game.read_bytes()[: start + 20])
    message = refused("replay", cut)
    assert f"{cut} is truncated within the files of its set-up" in message and "No such file" not in message


def test_rim_too_small_for_the_ground_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(SEQUENCE, folder)
    robot = folder / "robot.toml"
    text, changed = re.subn(r"(?m)^outer_radius_px = .*$", "outer_radius_px = 3", robot.read_text())
    robot.write_text(text if changed else text.replace("[camera]", "[camera]\nouter_radius_px = 3"))
    message = refused("locate", folder, "--out", tmp_path / "poses.csv")
    assert "camera.outer_radius_px = 3: no ground within the mirror's rim" in message


def test_line_points_beside_images_are_named_as_what_is_used(tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(SEQUENCE, folder)
    assert "note:" not in run("locate", folder, "--out", tmp_path / "poses.csv").stderr
    (folder / "points.csv").write_text("stamp_s,x_m,y_m\n0.0,1,0\n0.1,1,0\n")
    done = run("locate", folder, "--out", tmp_path / "poses.csv")
    assert done.returncode == 0
    assert f"note: {folder} has points.csv and frames.csv: the line points of points.csv are used" in done.stderr


def test_verifying_a_log_without_a_cycle_fails(game: Path, log_files: dict[str, bytes], tmp_path: Path) -> None:
    log = tmp_path / "empty.mcap"
    write_log(log, log_files, [], game)
    done = run("replay", log, "--verify", "--json")
    assert done.returncode == 1 and "nothing is verified" in done.stderr
    assert json.loads(done.stdout)["verified"]["identical"] is False


def limit_files(size: int) -> None:
    """Files of this process and its children end at that size, with an error as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (["calibrate", "mask", SEQUENCE, "--out"], "mask.png"),
        (["calibrate", "lines", SEQUENCE, "--out"], "map.npz"),
        (["locate", SEQUENCE, "--out"], "poses.csv"),
        (["recover", "GAME", "--out"], "whole.mcap"),
        (["mirror", "render", "lima2001", "--out"], "picture.png"),
    ],
)
def test_full_disk_leaves_the_earlier_output_and_no_part(game: Path, tmp_path: Path, command: list[object], name: str) -> None:
    out = tmp_path / name
    out.write_text("of an earlier run")
    arguments = [game if each == "GAME" else each for each in command]
    done = run(*arguments, out, preexec_fn=lambda: limit_files(200), restore_signals=False)
    assert done.returncode == 1, done.stdout
    assert f"{name}" in done.stderr
    assert out.read_text() == "of an earlier run"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_failed_export_of_the_package_leaves_the_earlier_file(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    with replacing(path) as part:
        part.write_text("first")
    with pytest.raises(OSError, match="full"), replacing(path) as part:
        part.write_text("sec")
        raise OSError("the disk is full")
    assert path.read_text() == "first"
    assert list(tmp_path.iterdir()) == [path]


def without_compass(robot: Path) -> None:
    """Nothing tells the robot's half of the field from the other one."""
    for name, section in (("robot.toml", r"\[compass\]"), ("hardware.toml", None)):
        text = (robot / name).read_text()
        if section is None:
            changed = text.replace("compass = true", "compass = false")
        else:
            changed = re.sub(section + r"\n(?:[^\[\n].*\n)*", "", text)
        assert changed != text, name
        (robot / name).write_text(changed)


@pytest.mark.parametrize("half_known", [True, False])
def test_log_after_a_full_disk_takes_a_free_name_and_verifies_from_the_state_that_it_holds(
    tmp_path: Path, half_known: bool
) -> None:
    robot, log, earlier, messages = (tmp_path / name for name in ("robot", "game.mcap", "game.2.mcap", "messages"))
    earlier.write_text("of an earlier run")
    with socket.socket(type=socket.SOCK_DGRAM) as states:
        states.bind(("127.0.0.1", 0))
        states.settimeout(60)
        network = tmp_path / "outputs.toml"
        network.write_text(f'[[outputs]]\nto = "127.0.0.1:{states.getsockname()[1]}"\nformat = "json"\n')
        sim = subprocess.Popen(
            [PROGRAM, "sim", SCENARIO, "--hardware", robot, "--duration", "60"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        until = time.monotonic() + 60
        while not (robot / "hardware.toml").exists():
            assert time.monotonic() < until
            time.sleep(0.02)
        if not half_known:
            without_compass(robot)
        with messages.open("w") as stderr:
            play = subprocess.Popen(
                [PROGRAM, "run", "--robot", robot, "--record", log, "--network", network, "--json"],
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
                restore_signals=False,
                preexec_fn=lambda: signal.signal(signal.SIGXFSZ, signal.SIG_IGN),
            )
        _, hard = resource.prlimit(play.pid, resource.RLIMIT_FSIZE)
        for _ in range(90):
            states.recv(65535)
        resource.prlimit(play.pid, resource.RLIMIT_FSIZE, (1000, hard))
        for _ in range(60):
            states.recv(65535)
        resource.prlimit(play.pid, resource.RLIMIT_FSIZE, (hard, hard))
        until = time.monotonic() + 60
        while "the log can be verified from the next cycle on" not in messages.read_text():
            assert time.monotonic() < until, messages.read_text()
            states.recv(65535)
        halves = [pose["half_known"] for _ in range(60) if (pose := json.loads(states.recv(65535))["pose"]) is not None]
        play.send_signal(signal.SIGTERM)
        out, _ = play.communicate(timeout=60)
        sim.terminate()
        sim.wait(30)
    assert play.returncode == 0, messages.read_text()
    # The new pipeline knows no more about the half than the one before.
    assert len(halves) > 30 and set(halves) == {half_known}, halves
    assert earlier.read_text() == "of an earlier run"
    summary = json.loads(out)["log"]
    assert [Path(file).name for file in summary["files"]] == ["game.mcap", "game.3.mcap"]
    assert summary["cycles_dropped"] > 0
    for name, starts, cycles in (("game.mcap", 0, 1), ("game.3.mcap", 1, 30)):
        done = run("replay", tmp_path / name, "--verify", "--json")
        assert done.returncode == 0, done.stderr
        verified = json.loads(done.stdout)["verified"]
        assert (verified["identical"], verified["different"]) == (True, 0)
        assert verified["cycles"] >= cycles and len(verified["verified_from_s"]) == starts
