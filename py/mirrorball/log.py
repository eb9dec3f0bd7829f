"""What did a robot or a simulation record? Mirrorball's MCAP logs, message by message or as numpy columns.

Read by Python's own `mcap` and `protobuf` (in C), not by the crates: the schemas travel in the file, so that topics of
later versions read too. One chunk (at most 1 MiB) is in memory at a time, whatever the log's size.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Getter = Callable[[Any], Any]
Column = tuple[str, Getter, Any]
"""Name, how it is got from a message, numpy's type."""


@dataclass(frozen=True)
class Entry:
    """One message: its topic, when it was logged (seconds), and what it says (a protobuf message)."""

    topic: str
    stamp_s: float
    message: Any


class LogError(ValueError):
    """The file is no log of mirrorball's, or is broken."""


class Log:
    """An MCAP log. Iterating and `columns` read the file anew each time, and hold one chunk of it."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        from mcap.exceptions import McapError

        self.whole = True
        """False if its writer was killed; then it is read from the start to its last whole chunk."""
        with self.path.open("rb") as file:
            try:
                self.about, self.counts = _summary(file, self.path)
            except McapError as error:
                if file.seek(0) == 0 and file.read(8) != b"\x89MCAP0\r\n":
                    raise LogError(f"{self.path} is no MCAP file") from error
                self.whole = False
                self.about, self.counts = {}, {}
        if not self.whole:
            self._count()

    def _count(self) -> None:
        from mcap.records import Channel, Message, Metadata

        topics: dict[int, str] = {}
        for record in self._records():
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Metadata) and record.name == "mirrorball":
                self.about = dict(record.metadata)
            elif isinstance(record, Message):
                topic = topics[record.channel_id]
                self.counts[topic] = self.counts.get(topic, 0) + 1

    def _records(self) -> Iterator[Any]:
        """Records of a cut file, up to where it ends."""
        from mcap.exceptions import McapError
        from mcap.stream_reader import StreamReader

        with self.path.open("rb") as file:
            reader = StreamReader(file)
            try:
                yield from reader.records
            except (McapError, EOFError):
                return

    @property
    def topics(self) -> list[str]:
        """Topics that have messages."""
        return sorted(topic for topic, count in self.counts.items() if count)

    def files(self) -> dict[str, bytes]:
        """Files that the run was made with: robot.toml, field.toml, map.npz, pipeline.toml (spine.toml in 0.1.0), …"""
        from mcap.reader import make_reader
        from mcap.records import Attachment

        if not self.whole:
            return {record.name: record.data for record in self._records() if isinstance(record, Attachment)}
        with self.path.open("rb") as file:
            return {attachment.name: attachment.data for attachment in make_reader(file).iter_attachments()}

    def messages(self, *topics: str, start_s: float | None = None, stop_s: float | None = None) -> Iterator[Entry]:
        """Messages of these topics (all, if none are named) in the order of their stamps, from start until before stop."""
        from mcap.reader import make_reader
        from mcap_protobuf.decoder import DecoderFactory

        wanted = list(topics) or None
        if not self.whole:
            yield from self._cut_messages(set(topics), start_s, stop_s)
            return
        start, stop = (None if s is None else max(0, round(1e9 * s)) for s in (start_s, stop_s))
        with self.path.open("rb") as file:
            reader = make_reader(file, decoder_factories=[DecoderFactory()])
            for found in reader.iter_decoded_messages(topics=wanted, starting_at=start, ending_before=stop):
                yield Entry(found.channel.topic, 1e-9 * found.message.log_time, found.decoded_message)

    def _cut_messages(self, topics: set[str], start_s: float | None, stop_s: float | None) -> Iterator[Entry]:
        from mcap.records import Channel, Message, Schema
        from mcap_protobuf.decoder import DecoderFactory

        schemas: dict[int, Schema] = {}
        channels: dict[int, tuple[str, Any]] = {}
        factory = DecoderFactory()
        for record in self._records():
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = (record.topic, factory.decoder_for(record.message_encoding, schemas[record.schema_id]))
            elif isinstance(record, Message):
                topic, decode = channels[record.channel_id]
                stamp = 1e-9 * record.log_time
                if (topics and topic not in topics) or (start_s is not None and stamp < start_s):
                    continue
                if stop_s is not None and stamp >= stop_s:
                    continue
                yield Entry(topic, stamp, decode(record.data))

    def columns(
        self,
        topic: str,
        *,
        more: dict[str, Getter] | None = None,
        start_s: float | None = None,
        stop_s: float | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Numbers and texts of a topic's messages, one array each; `a.b` of a message becomes column `a_b`.

        `stamp_s` is when each was logged. What a message lacks is NaN (an empty text); of lists there is their length,
        as `a_count`. `more` adds columns by functions of the message.
        """
        if topic not in self.counts:
            raise KeyError(f"{self.path} has no topic {topic}; it has {', '.join(self.topics)}")
        plan: list[Column] | None = None
        stamps: list[float] = []
        values: list[list[Any]] = []
        for entry in self.messages(topic, start_s=start_s, stop_s=stop_s):
            if plan is None:
                plan = _plan(entry.message.DESCRIPTOR) + [(name, get, np.float64) for name, get in (more or {}).items()]
                values = [[] for _ in plan]
            stamps.append(entry.stamp_s)
            for column, (_, get, _) in zip(values, plan, strict=True):
                column.append(get(entry.message))
        columns: dict[str, NDArray[Any]] = {"stamp_s": np.array(stamps)}
        for (name, _, kind), column in zip(plan or [], values, strict=True):
            columns[name] = np.array(column, dtype=kind)
        return columns

    def images(self, *, start_s: float | None = None, stop_s: float | None = None) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Stamps (seconds) and images (rows × columns × red, green, blue) one after the other."""
        from PIL import Image

        for entry in self.messages("/camera/image", start_s=start_s, stop_s=stop_s):
            with Image.open(io.BytesIO(entry.message.data)) as image:
                yield entry.stamp_s, np.asarray(image.convert("RGB"))


def _summary(file: Any, path: Path) -> tuple[dict[str, str], dict[str, int]]:
    from mcap.reader import make_reader

    reader = make_reader(file)
    summary = reader.get_summary()
    about = next((dict(found.metadata) for found in reader.iter_metadata() if found.name == "mirrorball"), None)
    if summary is None or about is None:
        raise LogError(f"{path} is an MCAP file, but no log of mirrorball")
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    return about, {channel.topic: counts.get(channel.id, 0) for channel in summary.channels.values()}


def _plan(
    descriptor: Any, prefix: str = "", get: Getter = lambda message: message, above: tuple[str, ...] = ()
) -> list[Column]:
    """What a message's columns are; a message inside itself (`above`) has no end, and no column.

    A message inside another may be missing: its numbers are floats, so that they can be NaN, in every piece of a log.
    """
    plan: list[Column] = []
    above = (*above, descriptor.full_name)
    for field in descriptor.fields:
        name, key = f"{prefix}{field.name}", field.name
        if field.is_repeated:
            plan.append((f"{name}_count", _counted(get, key), np.int64))
        elif field.message_type is None:
            if field.type == field.TYPE_BYTES:
                continue
            if field.type == field.TYPE_STRING:
                plan.append((name, _read(get, key, ""), object))
            else:
                whole = field.cpp_type not in (field.CPPTYPE_FLOAT, field.CPPTYPE_DOUBLE) and not prefix
                kind = np.bool_ if field.type == field.TYPE_BOOL else np.int64
                plan.append((name, _read(get, key, float("nan")), kind if whole else np.float64))
        elif field.message_type.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
            plan.append((f"{name}_s", _seconds(get, key), np.float64))
        elif field.message_type.full_name not in above:
            plan += _plan(field.message_type, f"{name}_", _inner(get, key), above)
    return plan


def _inner(get: Getter, key: str) -> Getter:
    def inner(message: Any) -> Any:
        outer = get(message)
        return getattr(outer, key) if outer is not None and outer.HasField(key) else None

    return inner


def _read(get: Getter, key: str, missing: Any) -> Getter:
    def read(message: Any) -> Any:
        outer = get(message)
        return missing if outer is None else getattr(outer, key)

    return read


def _counted(get: Getter, key: str) -> Getter:
    def counted(message: Any) -> int:
        outer = get(message)
        return 0 if outer is None else len(getattr(outer, key))

    return counted


def _seconds(get: Getter, key: str) -> Getter:
    def seconds(message: Any) -> float:
        outer = get(message)
        if outer is None or not outer.HasField(key):
            return float("nan")
        time = getattr(outer, key)
        return float(time.seconds + 1e-9 * time.nanos)

    return seconds
