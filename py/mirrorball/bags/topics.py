"""Which topics of a bag does a recording folder need? Those that are named, else the only ones of a fitting type."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from mirrorball.arguments import checked
from mirrorball.bags.reading import open_bag

__all__ = ["ROLES", "BagTopic", "Selection", "choose_topics", "list_topics", "topics_of"]

ROLES: dict[str, tuple[str, ...]] = {
    "image": ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"),
    "odometry": ("nav_msgs/msg/Odometry",),
    "imu": ("sensor_msgs/msg/Imu",),
    "compass": ("sensor_msgs/msg/MagneticField",),
    "truth": (),
}
"""Types by which the topic of a role is found."""

NAMED_ONLY: dict[str, tuple[str, ...]] = {
    "compass": (
        "std_msgs/msg/Float64",
        "std_msgs/msg/Float32",
        "geometry_msgs/msg/QuaternionStamped",
        "sensor_msgs/msg/Imu",
    ),
    "truth": (
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "nav_msgs/msg/Odometry",
    ),
}
"""Further types of a role, which a topic can have if it is named: by its type alone it could be anything."""

OWN_COMPASS = ("/compass", "geometry_msgs/msg/QuaternionStamped")
"""Name and type of the headings in a bag that Mirrorball wrote: they are found without being named."""


@dataclass(frozen=True)
class BagTopic:
    """A topic of a bag."""

    name: str
    type: str
    messages: int
    role: str | None
    """What an import would take it for by its type."""


@checked
@dataclass(frozen=True, kw_only=True)
class Selection:
    """Names of topics. None: found by type. Empty: left out."""

    image: str | None = None
    odometry: str | None = None
    imu: str | None = None
    compass: str | None = None
    truth: str | None = None


def topics_of(reader: Any) -> list[BagTopic]:
    """The topics of an open bag by name."""
    found = []
    for name, info in sorted(reader.topics.items()):
        # Several types under one name: none of them is usable by name.
        type_name = info.msgtype or "several types"
        role = next((role for role, types in ROLES.items() if type_name in types), None)
        if (name, type_name) == OWN_COMPASS:
            role = "compass"
        found.append(BagTopic(name, type_name, int(info.msgcount), role))
    return found


@checked
def list_topics(bag: str | Path) -> list[BagTopic]:
    """The topics of a bag by name."""
    with open_bag(bag) as reader:
        return topics_of(reader)


def choose_topics(topics: Iterable[BagTopic], selection: Selection) -> dict[str, BagTopic]:
    """The topic of each role; "magnetometer" is that of a magnetic field beside headings.

    ValueError: a name that is absent or of a wrong type, or several topics of a fitting type.
    """
    by_name = {topic.name: topic for topic in topics}
    chosen: dict[str, BagTopic] = {}
    for role in (field.name for field in fields(Selection)):
        name = getattr(selection, role)
        if name == "":
            continue
        if name is not None:
            chosen[role] = _named(role, name, by_name)
            continue
        found = [topic for topic in by_name.values() if topic.type in ROLES[role] and topic.messages > 0]
        # Drivers publish an image raw and compressed; the raw one is exact.
        raw = {topic.name for topic in found if topic.type == "sensor_msgs/msg/Image"}
        found = [topic for topic in found if topic.name.removesuffix("/compressed") not in raw or topic.name in raw]
        if len(found) > 1:
            names = ", ".join(topic.name for topic in found)
            raise ValueError(f"several topics for {role}: {names}. Name one with --{role}, or none with --{role} ''")
        if found:
            chosen[role] = found[0]
    own = by_name.get(OWN_COMPASS[0])
    if selection.compass is None and own is not None and own.role == "compass" and own.messages > 0:
        # The magnetic field belongs to the headings of the same stamps.
        if "compass" in chosen:
            chosen["magnetometer"] = chosen["compass"]
        chosen["compass"] = own
    return chosen


def _named(role: str, name: str, by_name: dict[str, BagTopic]) -> BagTopic:
    topic = by_name.get(name) or by_name.get(f"/{name}")
    if topic is None:
        raise ValueError(f"--{role} {name}: no such topic (expected one of {', '.join(by_name) or 'none: the bag is empty'})")
    known = ROLES[role] + NAMED_ONLY.get(role, ())
    if topic.type not in known:
        raise ValueError(f"--{role} {name}: type {topic.type} (expected {' or '.join(known)})")
    return topic
