"""How do the messages of one topic become rows? One converter for each role, which says why it skips a message."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from mirrorball.bags.images import encoded_image
from mirrorball.bags.motion import OdometryIncrements, StaticRotations, heading_of, planar_pose, rotation_matrix
from mirrorball.bags.topics import BagTopic

__all__ = ["CONVERTERS", "TableWriter", "seconds"]


def seconds(stamp_ns: int) -> str:
    """Nanoseconds as exact decimal seconds."""
    sign, whole = ("-", -stamp_ns) if stamp_ns < 0 else ("", stamp_ns)
    return f"{sign}{whole // 1_000_000_000}.{whole % 1_000_000_000:09d}"


class TableWriter(ABC):
    """Writes the rows of one topic, and counts what it skipped by reason."""

    file_name = ""
    columns = ""

    def __init__(self, folder: Path, topic: BagTopic, rotations: StaticRotations, base: str | None) -> None:
        self.folder, self.topic, self.rotations, self.base = folder, topic, rotations, base
        self.rows = 0
        self.skipped: Counter[str] = Counter()
        self.notes: list[str] = []
        self.first_ns: int | None = None
        self.last_ns: int | None = None
        self.file: TextIO = (folder / self.file_name).open("w", encoding="utf-8")
        self.file.write(self.columns + "\n")

    def write(self, stamp_ns: int, message: Any) -> None:
        """Adds a message, or counts why it is skipped."""
        try:
            row = self.row(stamp_ns, message)
        except ValueError as error:
            self.skipped[str(error)] += 1
            return
        if row is None:
            return
        self.first_ns = stamp_ns if self.first_ns is None else min(self.first_ns, stamp_ns)
        self.last_ns = stamp_ns if self.last_ns is None else max(self.last_ns, stamp_ns)
        self.rows += 1
        self.file.write(f"{seconds(stamp_ns)},{row}\n")

    @abstractmethod
    def row(self, stamp_ns: int, message: Any) -> str | None:
        """The row behind its stamp. None: the message has no row. ValueError: why the message is skipped."""

    def finish(self) -> None:
        """Completes the file; one without rows is removed."""
        self.file.close()
        if self.rows == 0:
            (self.folder / self.file_name).unlink()

    def note(self, text: str) -> None:
        """Remembers a sentence once."""
        if text not in self.notes:
            self.notes.append(text)

    def in_robot_axes(self, frame: str) -> NDArray[np.float64]:
        """The rotation from a device's frame to the robot's, by /tf_static."""
        base = self.base or "base_link"
        rotation = self.rotations.between(base, frame)
        if rotation is not None:
            if not np.allclose(rotation, np.eye(3)):
                self.note(f"turned from {frame} to {base} by /tf_static")
            return rotation
        self.note(f"/tf_static does not connect {frame or 'its empty frame'} with {base}: taken as the robot's axes")
        return np.eye(3)


class ImageWriter(TableWriter):
    """frames.csv, and the images."""

    file_name, columns = "frames.csv", "stamp_s,file"

    def row(self, stamp_ns: int, message: Any) -> str:
        """Writes the image."""
        data, ending = encoded_image(message)
        name = f"frames/{self.rows:06d}.{ending}"
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)
        return name


class OdometryWriter(TableWriter):
    """odometry.csv."""

    file_name, columns = "odometry.csv", "stamp_s,dx_m,dy_m,dtheta_rad"

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.increments = OdometryIncrements()
        self.moved = self.reported = False

    def row(self, stamp_ns: int, message: Any) -> str | None:
        """The increment since the previous message; the first one has none."""
        increment = self.increments.add(stamp_ns, planar_pose(message.pose.pose))
        twist = message.twist.twist
        self.reported |= abs(twist.linear.x) + abs(twist.linear.y) + abs(twist.angular.z) > 0.01
        if increment is None:
            return None
        self.moved |= any(abs(value) > 1e-9 for value in increment)
        return ",".join(repr(value) for value in increment)

    def finish(self) -> None:
        """Notes a driver that fills in only the velocity."""
        if self.reported and not self.moved:
            self.note(
                "the pose never changes although the velocity does: a driver that fills in only the velocity is no odometry"
            )
        super().finish()


class ImuWriter(TableWriter):
    """imu.csv."""

    file_name, columns = "imu.csv", "stamp_s,ax_m_s2,ay_m_s2,az_m_s2,wx_rad_s,wy_rad_s,wz_rad_s"

    def row(self, stamp_ns: int, message: Any) -> str:
        """Specific force and rate in the robot's axes."""
        # REP 145: -1 in the first element of a covariance says that the quantity is not measured.
        if message.linear_acceleration_covariance[0] == -1 or message.angular_velocity_covariance[0] == -1:
            raise ValueError("the unit measures no acceleration or no rate")
        rotation = self.in_robot_axes(message.header.frame_id)
        values = [
            value
            for vector in (message.linear_acceleration, message.angular_velocity)
            for value in rotation @ (vector.x, vector.y, vector.z)
        ]
        if not all(math.isfinite(value) for value in values):
            raise ValueError("a value that is not finite")
        return ",".join(repr(float(value)) for value in values)


class MagnetometerWriter(TableWriter):
    """magnetometer.csv: the horizontal field in the robot's axes."""

    file_name, columns = "magnetometer.csv", "stamp_s,x,y"

    def row(self, stamp_ns: int, message: Any) -> str:
        """The horizontal part, tesla."""
        field = message.magnetic_field
        x, y, _ = self.in_robot_axes(message.header.frame_id) @ (field.x, field.y, field.z)
        if not (math.isfinite(x) and math.isfinite(y)):
            raise ValueError("a value that is not finite")
        return f"{float(x)!r},{float(y)!r}"


class CompassWriter(TableWriter):
    """compass.csv, of a topic that holds a heading: radians, counter-clockwise."""

    file_name, columns = "compass.csv", "stamp_s,heading_rad"

    def row(self, stamp_ns: int, message: Any) -> str:
        """The heading, by the message's own zero."""
        if hasattr(message, "data"):
            heading = float(message.data)
        elif hasattr(message, "quaternion"):
            heading = heading_of(rotation_matrix(message.quaternion))
        else:
            if message.orientation_covariance[0] == -1:
                raise ValueError("the unit measures no orientation")
            unit = rotation_matrix(message.orientation)
            heading = heading_of(unit @ self.in_robot_axes(message.header.frame_id).T)
        if not math.isfinite(heading):
            raise ValueError("a value that is not finite")
        self.note("headings have the topic's own zero, and are radians counter-clockwise")
        return repr(heading)


class TruthWriter(TableWriter):
    """truth.csv."""

    file_name, columns = "truth.csv", "stamp_s,x_m,y_m,theta_rad"

    def row(self, stamp_ns: int, message: Any) -> str:
        """The pose on the field."""
        pose = message.pose if hasattr(message.pose, "position") else message.pose.pose
        return ",".join(repr(value) for value in planar_pose(pose))


CONVERTERS: dict[str, type[TableWriter]] = {
    "image": ImageWriter,
    "odometry": OdometryWriter,
    "imu": ImuWriter,
    "compass": CompassWriter,
    "magnetometer": MagnetometerWriter,
    "truth": TruthWriter,
}
