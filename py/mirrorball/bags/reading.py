"""How is a bag opened? By the package `rosbags`, with each failure of a file as one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

__all__ = ["decode", "message_stamp_ns", "open_bag"]


@contextmanager
def open_bag(path: str | Path) -> Iterator[Any]:
    """The bag as a `rosbags` reader. ValueError: the package is absent, or the file is no bag or is damaged."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise ValueError(f"no module {error.name}: bags need mirrorball[bags] or requirements.txt") from None
    bag = Path(path)
    if not bag.exists():
        raise ValueError(f"{bag}: no such file")
    if bag.is_dir() and not (bag / "metadata.yaml").exists():
        raise ValueError(f"{bag}: not the folder of a ROS 2 bag (it has no metadata.yaml)")
    if not bag.is_dir() and bag.suffix not in {".bag", ".db3", ".mcap"}:
        raise ValueError(f"{bag}: not a bag (expected .bag, .mcap, .db3 or the folder of a ROS 2 bag)")
    if _is_mirrorball_log(bag):
        raise ValueError(
            f"{bag}: a log of mirrorball, not a bag: `mirrorball replay {bag} --export DIR` writes its recording folder"
        )
    try:
        # Bags of ROS 2 before Iron hold no message definitions. Those of the standard messages have not changed since.
        with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except AnyReaderError as error:
        raise ValueError(f"{bag}: cannot read the bag: {error}") from None
    except (KeyError, AssertionError, IndexError, RuntimeError) as error:
        # What `rosbags` raises for damaged files beside its own error.
        if type(error).__module__ == "builtins" and not _is_from_rosbags(error):
            raise
        raise ValueError(f"{bag}: the bag is damaged ({type(error).__name__}: {error})") from None
    except Exception as error:
        if not _is_from_rosbags(error):
            raise
        raise ValueError(f"{bag}: the bag is damaged ({type(error).__name__}: {error})") from None


def _is_mirrorball_log(path: Path) -> bool:
    """True for an MCAP file whose header names mirrorball as its profile."""
    if path.suffix != ".mcap" or not path.is_file():
        return False
    # The magic bytes, the header's opcode and length, and the profile with its length.
    with path.open("rb") as file:
        return file.read(64)[17:].startswith(b"\x0a\x00\x00\x00mirrorball")


def _is_from_rosbags(error: BaseException) -> bool:
    """True if the error was raised inside `rosbags` or what it calls."""
    trace, inside = error.__traceback__, False
    while trace is not None:
        inside = inside or "rosbags" in trace.tb_frame.f_globals.get("__name__", "").split(".")
        trace = trace.tb_next
    return inside


def decode(reader: Any, data: bytes, type_name: str) -> Any | None:
    """The message, or None if its bytes do not fit its type."""
    try:
        return reader.deserialize(data, type_name)
    except Exception as error:
        if _is_from_rosbags(error):
            return None
        raise


def message_stamp_ns(message: Any, received_ns: int) -> tuple[int, bool]:
    """Nanoseconds of the header's stamp, and True; without one the time at which the bag received the message, and False."""
    header = getattr(message, "header", None)
    if header is None:
        return received_ns, False
    stamp_ns = int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
    return (stamp_ns, True) if stamp_ns else (received_ns, False)
