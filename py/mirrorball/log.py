"""Mirrorball's MCAP logs, message by message or as numpy columns.

Read by the crates: columns are filled in Rust, with Python's lock released. The schemas are in the file, so that topics of
other versions can be read, too. One chunk (at most 4 MiB) is in memory at a time, whatever the log's size.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mirrorball._core import LogError, LogReader
from mirrorball.arguments import Number, invalid
from mirrorball.records import Record

__all__ = ["Log", "LogError", "LogMessage"]


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True, eq=False)
class LogMessage(Record):
    """One message: its topic, when it was logged (seconds), and its fields as attributes.

    Lists of numbers are numpy arrays. An absent message or optional value is None.
    """

    topic: str
    stamp_s: float
    message: Any


class Log:
    """An MCAP log. Iterating and `columns` read the file anew each time, and hold one chunk of it."""

    def __init__(self, path: str | Path) -> None:
        self._reader = LogReader(path)
        self.path = Path(path)
        self.complete = self._reader.complete
        """False if its writer was killed; then it is read from the start to its last complete chunk."""
        self.about = self._reader.metadata
        """Version, source, seed, … of the run."""
        self.message_counts = self._reader.message_counts

    def __repr__(self) -> str:
        return f"Log({str(self.path)!r}, {sum(self.message_counts.values())} messages)"

    def __eq__(self, other: object) -> bool:
        """The same file."""
        return isinstance(other, Log) and self.path.resolve() == other.path.resolve()

    def __hash__(self) -> int:
        return hash(self.path.resolve())

    def __reduce__(self) -> tuple[type[Log], tuple[Path]]:
        return Log, (self.path,)

    def _require_topics(self, *topics: str) -> None:
        for topic in topics:
            # What is no text is refused where it is read.
            if isinstance(topic, str) and topic not in self.message_counts:
                raise KeyError(f"{self.path} has no topic {topic}; it has {', '.join(self.topics) or 'none'}")

    @property
    def topics(self) -> list[str]:
        """Topics that have messages."""
        return sorted(topic for topic, count in self.message_counts.items() if count)

    def files(self) -> dict[str, bytes]:
        """Files that the run was made with: robot.toml, field.toml, map.npz, pipeline.toml (spine.toml in 0.1.0), …"""
        return self._reader.files()

    def messages(self, *topics: str, start_s: Number | None = None, stop_s: Number | None = None) -> Iterator[LogMessage]:
        """Messages of these topics (all, if none are named) from start until before stop.

        Those of one topic come in the order of their stamps, those of different topics chunk by chunk: an image
        precedes its annotations. KeyError for a topic that the log does not have.
        """
        self._require_topics(*topics)
        found = self._reader.messages(topics, start_s=start_s, stop_s=stop_s)
        return (LogMessage(topic, 1e-9 * stamp_ns, message) for topic, stamp_ns, message in found)

    def columns(
        self,
        topic: str,
        *,
        elements: Sequence[str] = (),
        start_s: Number | None = None,
        stop_s: Number | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Numbers and texts of a topic's messages, one array each; `a.b` of a message becomes column `a_b`.

        `stamp_s` is when each was logged. An absent number is NaN, an absent text empty; lists have their length, as
        `a_count`. Nanosecond stamps (`…_ns`) are int64, −1 where absent. `elements` adds columns of single list
        elements: "estimate.covariance[0]" becomes `estimate_covariance_0`, NaN where the list is shorter.

        KeyError for a topic that the log does not have, ValueError for an element that none of the lists has, unless all
        of them are empty.
        """
        self._require_topics(topic)
        found = self._reader.columns(topic, elements=elements, start_s=start_s, stop_s=stop_s)
        for element in elements:
            _require_element(element, found)
        return found

    def rows(
        self, topic: str, field: str, *, start_s: Number | None = None, stop_s: Number | None = None
    ) -> dict[str, NDArray[Any]]:
        """Columns of a list inside a topic's messages, one row an entry; `stamp_s` is when its message was logged.

        `field` names a list of messages ("team.mates") or a message of parallel lists ("points").
        """
        self._require_topics(topic)
        return self._reader.rows(topic, field, start_s=start_s, stop_s=stop_s)

    def log_times_ns(self, topic: str) -> NDArray[np.uint64]:
        """When a topic's messages were logged, nanoseconds, ascending."""
        self._require_topics(topic)
        return self._reader.log_times(topic)

    def images(
        self, *, start_s: Number | None = None, stop_s: Number | None = None
    ) -> Iterator[tuple[float, NDArray[np.uint8]]]:
        """Stamps (seconds) and images (rows × columns × red, green, blue) one after the other."""
        found = self._reader.images(start_s=start_s, stop_s=stop_s)
        return ((1e-9 * stamp_ns, image) for stamp_ns, image in found)


def _require_element(element: str, columns: dict[str, NDArray[Any]]) -> None:
    """Raises ValueError for an index that no list has. All lists of a robot that is lost throughout are empty."""
    name, _, index = element.removesuffix("]").partition("[")
    longest = int(columns[f"{name.replace('.', '_')}_count"].max(initial=0))
    if int(index) < 0 or 0 < longest <= int(index):
        raise ValueError(
            invalid("elements", element, f"an index of 0 to {longest - 1}" if longest else "an index of at least 0")
        )
