"""Columns of logs as the crates read them, compared with Python's own mcap and protobuf as an independent reader."""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from mirrorball.log import Log, LogError

TIMES = ("google.protobuf.Timestamp", "google.protobuf.Duration")


def messages(path: Path, *topics: str) -> list[tuple[int, Any]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = reader.iter_decoded_messages(topics=list(topics))
        return [(one.message.log_time, one.decoded_message) for one in found]


def expected_columns(message: Any, descriptor: Any, prefix: str = "", above: tuple[str, ...] = ()) -> dict[str, Any]:
    """What the columns of one message should hold; `message` is None where it is absent."""
    row: dict[str, Any] = {}
    for field in descriptor.fields:
        name = f"{prefix}{field.name}"
        if field.is_repeated:
            row[f"{name}_count"] = len(getattr(message, field.name)) if message is not None else 0
        elif field.type == field.TYPE_STRING:
            row[name] = getattr(message, field.name) if message is not None else ""
        elif field.type == field.TYPE_BYTES:
            continue
        elif field.message_type is None:
            absent = message is None or (field.has_presence and not message.HasField(field.name))
            row[name] = (-1 if name.endswith("_ns") else math.nan) if absent else getattr(message, field.name)
        else:
            inner = getattr(message, field.name) if message is not None and message.HasField(field.name) else None
            kind = field.message_type
            if kind.full_name in TIMES:
                row[f"{name}_s"] = math.nan if inner is None else inner.seconds + 1e-9 * inner.nanos
            elif kind.full_name not in (*above, descriptor.full_name):
                row |= expected_columns(inner, kind, f"{name}_", (*above, descriptor.full_name))
    return row


def test_columns_of_every_topic_match_an_independent_reader(game: Path) -> None:
    log = Log(game)
    for topic in log.topics:
        found = messages(game, topic)
        rows = [expected_columns(message, message.DESCRIPTOR) for _, message in found]
        columns = log.columns(topic)
        assert columns.pop("stamp_s").tolist() == [1e-9 * time for time, _ in found], topic
        assert list(columns) == list(rows[0]), topic
        for name, values in columns.items():
            np.testing.assert_array_equal(values, [row[name] for row in rows], err_msg=f"{topic} {name}")
        assert log.message_counts[topic] == len(found)


def test_stamps_are_integers_and_absent_optional_values_nan(game: Path) -> None:
    cycles = Log(game).columns("/cycle")
    for name in ("stamp_ns", "estimate_stamp_ns", "truth_stamp_ns", "world_ball_seen_ns"):
        assert cycles[name].dtype == np.int64, name
    assert (cycles["estimate_stamp_ns"] == cycles["stamp_ns"]).all()
    sensors = Log(game).columns("/vision/sensors")
    assert np.isnan(sensors["exposure_command_exposure"]).any()


def test_list_elements_and_entries_match_an_independent_reader(game: Path) -> None:
    log = Log(game)
    cycles = [message for _, message in messages(game, "/cycle")]
    element = log.columns("/cycle", elements=["estimate.covariance[4]", "estimate.lean[1]"])
    variances = [cycle.estimate.covariance[4] if len(cycle.estimate.covariance) > 4 else math.nan for cycle in cycles]
    np.testing.assert_array_equal(element["estimate_covariance_4"], variances)
    points = log.rows("/cycle", "points")
    assert points["x"].tolist() == [x for cycle in cycles for x in cycle.points.x]
    assert points["stamp_s"].tolist() == [1e-9 * cycle.stamp_ns for cycle in cycles for _ in cycle.points.x]
    odometry = log.rows("/cycle", "odometry")
    assert odometry["stamp_ns"].tolist() == [one.stamp_ns for cycle in cycles for one in cycle.odometry]
    with pytest.raises(LogError, match="no field nothing"):
        log.columns("/cycle", elements=["nothing[0]"])
    with pytest.raises(LogError, match="neither a list"):
        log.rows("/cycle", "index")


@pytest.mark.parametrize("index", [-1, 9, 99])
def test_element_that_no_list_has_is_refused(index: int, game: Path) -> None:
    element = f"estimate.covariance[{index}]"
    with pytest.raises(ValueError, match=rf"invalid elements: '{re.escape(element)}' \(expected an index of 0 to 8\)"):
        Log(game).columns("/cycle", elements=[element])
    # Lists that are all empty say nothing of their length.
    nothing = Log(game).columns("/cycle", elements=["estimate.covariance[8]"], stop_s=0.0)
    assert len(nothing["estimate_covariance_8"]) == 0


def test_unknown_topic_is_named_with_those_of_the_log(game: Path) -> None:
    log = Log(game)
    reads: list[Callable[[], object]] = [
        lambda: log.columns("/nope"), lambda: log.rows("/nope", "points"), lambda: log.log_times_ns("/nope"),
        lambda: log.messages("/nope"), lambda: log.messages("/imu", "/nope"),
    ]  # fmt: skip
    for read in reads:
        with pytest.raises(KeyError, match=r"game\.mcap has no topic /nope; it has .*/imu, "):
            read()


def test_messages_have_their_fields_as_attributes(game: Path) -> None:
    log = Log(game)
    for found, (time, message) in zip(log.messages("/cycle"), messages(game, "/cycle"), strict=True):
        assert (found.topic, found.stamp_s) == ("/cycle", 1e-9 * time)
        assert found.message.stamp_ns == message.stamp_ns and found.message.image == message.image
        assert found.message.points.x.tolist() == list(message.points.x)
        assert (found.message.truth is None) == (not message.HasField("truth"))
    some = list(log.messages("/imu", "/compass", start_s=0.5, stop_s=1.0))
    assert {one.topic for one in some} == {"/imu", "/compass"}
    assert all(0.5 <= one.stamp_s < 1.0 for one in some)
    assert sum(one.topic == "/imu" for one in some) == len(log.columns("/imu", start_s=0.5, stop_s=1.0)["stamp_s"])


def test_images_match_an_independent_decoder(game: Path) -> None:
    (_, message), (stamp, image) = messages(game, "/camera/image")[0], next(Log(game).images())
    pixels = cv2.imdecode(np.frombuffer(message.data, dtype=np.uint8), cv2.IMREAD_COLOR)
    assert pixels is not None and stamp == 0.0
    np.testing.assert_array_equal(image, pixels[:, :, ::-1])


def test_truncated_log_has_the_columns_of_its_complete_chunks(game: Path, tmp_path: Path) -> None:
    part = tmp_path / "part.mcap"
    part.write_bytes(game.read_bytes()[: game.stat().st_size * 2 // 3])
    whole, found = Log(game), Log(part)
    for topic in ("/cycle", "/imu"):
        columns = found.columns(topic)
        count = found.message_counts[topic]
        assert 0 < count < whole.message_counts[topic]
        for name, values in whole.columns(topic).items():
            np.testing.assert_array_equal(columns[name], values[:count])


def test_damaged_chunk_is_named(game: Path, tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.mcap"
    content = bytearray(game.read_bytes())
    content[len(content) // 2] ^= 0xFF
    damaged.write_bytes(content)
    with pytest.raises(LogError, match=r"damaged\.mcap: chunk at byte .*`mirrorball recover` saves what can be read"):
        list(Log(damaged).messages())
    short = tmp_path / "short.mcap"
    short.write_bytes(content[:20])
    with pytest.raises(LogError, match="no log of mirrorball"):
        Log(short)
