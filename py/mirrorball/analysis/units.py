"""In which unit is a column? Messages name quantities; tables add the unit to the name.

Names of messages are contracts with the logs of earlier versions and stay without units.
"""

from __future__ import annotations

import re

__all__ = ["DIMENSIONLESS", "UNIT", "with_unit"]

UNIT = re.compile(r".*(_s|_ns|_ms|_m|_m2|_mrad|_mps|_mps2|_rad|_rad2|_radps|_px)$")
"""Names that end with their unit."""

DIMENSIONLESS = re.compile(
    "|".join(
        (
            r"stamp_s|.*_count|.*(^|_)(index|id|images|knocks|frames|level|line|line_points|refused|point_stride|pixels)",
            r".*(^|_)(score|probability|share|entropy|exposure|gain|nees|evidence|brightness|inlier_share)",
            r".*_(certificate_points|others_share_max|unlisted_share_max|expected_log_odds)",
            r".*_(markings|markings_seen|wheels|compass|from_frame|runners_up|seen|tracked)|runners_up",
            # Quaternions.
            r".*(orientation|rotation)_[xyzw]",
            # True or false.
            r".*(^|_)(on_ground|is_attained|learned|kick|lens_centred|half_known|collision|searching|light_jumped)",
            # Texts.
            r".*(^|_)(image|mode|reason|text|fault|warning|team|settings|warm_start|map_fit|frame_id|format|message|name|file|level|distortion_model)",
        )
    )
)
"""Names of numbers without a unit, of truth values and of texts."""

_BY_TOPIC = {
    "/command": {"x": "_mps", "y": "_mps", "theta": "_radps"},
    "/vision/ball": {"x": "_m", "y": "_m"},
    "/truth/error": {"x": "_m", "y": "_m", "distance": "_m"},
    "/camera/calibration": {"width": "_px", "height": "_px"},
}

_BY_NAME = (
    (re.compile(r".*velocity_[xyz]"), "_mps"),
    (re.compile(r".*acceleration_[xyz]"), "_mps2"),
    (re.compile(r".*(^|_)rate_[xyz]|.*gyro_bias"), "_radps"),
    (re.compile(r".*(position|ball|pose|on_field|from_robot|state|translation)_[xyz]|.*ball_height"), "_m"),
    (re.compile(r"(.*_)?d[xy]|.*residual|slip"), "_m"),
    (re.compile(r"(.*_)?(dtheta|theta|heading)"), "_rad"),
    (re.compile(r".*latency"), "_s"),
)


def with_unit(name: str, topic: str) -> str:
    """The name of a topic's column with its unit, if the name has none and the quantity has one."""
    if unit := _BY_TOPIC.get(topic, {}).get(name):
        return name + unit
    return next((name + unit for pattern, unit in _BY_NAME if pattern.fullmatch(name)), name)
