"""What do messages of motion say in the robot's frame? Increments of odometry, rotated vectors, headings."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["OdometryIncrements", "StaticRotations", "heading_of", "planar_pose", "rotation_matrix"]

SPEED_MAX = 20.0
"""Fastest motion between two poses of odometry, m/s and ten times that in rad/s; a faster one is a reset."""


def rotation_matrix(quaternion: Any) -> NDArray[np.float64]:
    """Of a message with x, y, z, w. ValueError: it is no unit quaternion."""
    values = np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w], dtype=np.float64)
    norm = float(np.linalg.norm(values))
    if not abs(norm - 1.0) < 0.05:
        raise ValueError(f"orientation of length {norm:.3g} (expected a unit quaternion)")
    x, y, z, w = values / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def heading_of(rotation: NDArray[np.float64]) -> float:
    """Direction of the x axis in the plane, radians."""
    return math.atan2(rotation[1, 0], rotation[0, 0])


def planar_pose(pose: Any) -> tuple[float, float, float]:
    """x, y, heading of a geometry_msgs/Pose. ValueError: not finite, or no unit quaternion."""
    heading = heading_of(rotation_matrix(pose.orientation))
    x, y = float(pose.position.x), float(pose.position.y)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError("a position that is not finite")
    return x, y, heading


class OdometryIncrements:
    """Motion since the previous pose, in the robot frame of the previous pose."""

    def __init__(self) -> None:
        self.last: tuple[int, tuple[float, float, float]] | None = None

    def add(self, stamp_ns: int, pose: tuple[float, float, float]) -> tuple[float, float, float] | None:
        """The increment, None for the first pose. ValueError: a stamp that does not grow, or a reset."""
        previous, now = self.last, (stamp_ns, pose)
        if previous is None:
            self.last = now
            return None
        (last_ns, (x, y, theta)) = previous
        if stamp_ns <= last_ns:
            raise ValueError("a stamp that is not above the previous one")
        self.last = now
        duration = (stamp_ns - last_ns) / 1e9
        east, north = pose[0] - x, pose[1] - y
        turn = math.remainder(pose[2] - theta, math.tau)
        if math.hypot(east, north) > SPEED_MAX * max(duration, 0.05):
            raise ValueError(f"a jump of more than {SPEED_MAX:g} m/s: the odometry was reset")
        forward = math.cos(theta) * east + math.sin(theta) * north
        left = -math.sin(theta) * east + math.cos(theta) * north
        return forward, left, turn


class StaticRotations:
    """Rotations between frames by the messages of /tf_static."""

    def __init__(self) -> None:
        self.neighbours: dict[str, list[tuple[str, NDArray[np.float64]]]] = {}

    def add(self, transforms: Iterable[Any]) -> None:
        """Adds transforms; one without a unit quaternion is left out."""
        for transform in transforms:
            try:
                parent_from_child = rotation_matrix(transform.transform.rotation)
            except ValueError:
                continue
            parent, child = _plain(transform.header.frame_id), _plain(transform.child_frame_id)
            self.neighbours.setdefault(parent, []).append((child, parent_from_child))
            self.neighbours.setdefault(child, []).append((parent, parent_from_child.T))

    def between(self, target: str, source: str) -> NDArray[np.float64] | None:
        """The rotation that turns vectors of `source` to `target`. None: the frames are not connected."""
        target, source = _plain(target), _plain(source)
        found = {target: np.eye(3)}
        queue = deque([target])
        while queue:
            frame = queue.popleft()
            if frame == source:
                return found[frame]
            for neighbour, rotation in self.neighbours.get(frame, []):
                if neighbour not in found:
                    found[neighbour] = found[frame] @ rotation
                    queue.append(neighbour)
        return None


def _plain(frame: str) -> str:
    """ROS 1 may write a frame with a slash in front."""
    return frame.lstrip("/")
