"""What does an import write? The tables and images of a recording folder, and a summary of what was skipped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mirrorball.arguments import checked
from mirrorball.bags.motion import StaticRotations
from mirrorball.bags.reading import decode, message_stamp_ns, open_bag
from mirrorball.bags.tables import CONVERTERS, TableWriter
from mirrorball.bags.topics import BagTopic, Selection, choose_topics, topics_of

__all__ = ["ImportSummary", "ImportedTopic", "import_bag"]

CLOCKS_APART_S = 5.0
"""Topics whose ranges of time do not meet within this time have clocks of their own."""


@dataclass(frozen=True)
class ImportedTopic:
    """What became of a topic."""

    role: str
    topic: str
    type: str
    file: str
    rows: int
    first_s: float | None
    last_s: float | None
    skipped: dict[str, int]
    """Numbers of messages by the reason why they are not in the folder."""
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ImportSummary:
    """What an import wrote."""

    start_s: float
    stop_s: float
    """Range of the bag's own times, since 1970."""
    topics: tuple[ImportedTopic, ...]
    unused: tuple[BagTopic, ...]
    """Topics that no table of a recording needs."""
    warnings: tuple[str, ...]


@checked
def import_bag(
    bag: str | Path,
    folder: str | Path,
    *,
    selection: Selection | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    base_frame: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ImportSummary:
    """Writes the tables and images of a bag into an existing folder.

    `start_s`, `stop_s`: part of the bag, seconds since its start. `base_frame`: the robot's frame (default: that of the
    odometry, else base_link). `progress` is called with the number of messages done, and of all. ValueError: no bag, or
    nothing in it that a recording needs.
    """
    with open_bag(bag) as reader:
        topics = topics_of(reader)
        chosen = choose_topics(topics, selection or Selection())
        if not chosen:
            raise ValueError(f"{bag}: no topic for a recording (expected images, odometry, imu or magnetic field)")
        rotations, base = _static_rotations(reader), base_frame or _base_frame(reader, chosen.get("odometry"))
        writers = {role: _writer(role, topic, Path(folder), rotations, base) for role, topic in chosen.items()}
        start_ns = int(reader.start_time)
        window = [None if edge is None else start_ns + round(edge * 1e9) for edge in (start_s, stop_s)]
        _convert(reader, writers, window, progress)
        times = (start_ns / 1e9, int(reader.end_time) / 1e9)
    for writer in writers.values():
        writer.finish()
    imported = tuple(_summary(role, writer) for role, writer in writers.items())
    used = {topic.name for topic in chosen.values()}
    unused = tuple(topic for topic in topics if topic.name not in used)
    return ImportSummary(*times, imported, unused, tuple(_warnings(imported)))


def _writer(role: str, topic: BagTopic, folder: Path, rotations: StaticRotations, base: str | None) -> TableWriter:
    kind = "magnetometer" if topic.type == "sensor_msgs/msg/MagneticField" else role
    writer = CONVERTERS[kind](folder, topic, rotations, base)
    if role == "compass" and kind == "magnetometer":
        writer.note("make compass.csv of it by `mirrorball calibrate compass`")
    return writer


def _static_rotations(reader: Any) -> StaticRotations:
    rotations = StaticRotations()
    connections = [one for one in reader.connections if one.topic in {"/tf_static", "tf_static"}]
    # Without connections the reader would give every message.
    for connection, _, data in reader.messages(connections=connections) if connections else ():
        message = decode(reader, data, connection.msgtype)
        if message is not None and hasattr(message, "transforms"):
            rotations.add(message.transforms)
    return rotations


def _base_frame(reader: Any, odometry: BagTopic | None) -> str | None:
    connections = [one for one in reader.connections if odometry is not None and one.topic == odometry.name]
    for connection, _, data in reader.messages(connections=connections) if connections else ():
        message = decode(reader, data, connection.msgtype)
        if message is not None and message.child_frame_id:
            return str(message.child_frame_id)
    return None


def _convert(
    reader: Any,
    writers: dict[str, TableWriter],
    window: list[int | None],
    progress: Callable[[int, int], None] | None,
) -> None:
    names = {writer.topic.name for writer in writers.values()}
    connections = [one for one in reader.connections if one.topic in names]
    total = sum(int(one.msgcount) for one in connections)
    messages = reader.messages(connections=connections, start=window[0], stop=window[1])
    for done, (connection, received_ns, data) in enumerate(messages, 1):
        message = decode(reader, data, connection.msgtype)
        for writer in writers.values():
            if writer.topic.name != connection.topic:
                continue
            if message is None:
                writer.skipped["bytes that do not fit the type"] += 1
                continue
            stamp_ns, has_own_stamp = message_stamp_ns(message, received_ns)
            if not has_own_stamp:
                writer.note("messages without a stamp of their own have the time at which the bag received them")
            writer.write(stamp_ns, message)
        if progress is not None and (done % 50 == 0 or done == total):
            progress(done, total)


def _summary(role: str, writer: TableWriter) -> ImportedTopic:
    first_s, last_s = (None if edge is None else edge / 1e9 for edge in (writer.first_ns, writer.last_ns))
    topic = writer.topic
    return ImportedTopic(
        role,
        topic.name,
        topic.type,
        writer.file_name,
        writer.rows,
        first_s,
        last_s,
        dict(writer.skipped),
        tuple(writer.notes),
    )


def _warnings(topics: tuple[ImportedTopic, ...]) -> list[str]:
    warnings = [f"{topic.topic}: no row for {topic.file}" for topic in topics if topic.rows == 0]
    images = next((topic for topic in topics if topic.role == "image" and topic.rows > 0), None)
    if images is None:
        warnings.append("no images: add points.csv, or name a topic with --image")
        return warnings
    for topic in topics:
        if topic.first_s is None or topic.last_s is None or images.first_s is None or images.last_s is None:
            continue
        if topic.first_s > images.last_s + CLOCKS_APART_S or images.first_s > topic.last_s + CLOCKS_APART_S:
            warnings.append(
                f"the stamps of {topic.topic} do not overlap those of {images.topic}: the devices have different clocks"
            )
    return warnings
