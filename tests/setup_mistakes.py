"""Recording folders with one typical mistake each, made from a right one.

As a script: `python3 tests/setup_mistakes.py samples/sequence wrong` makes all of them.
"""

import math
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]


def replace_value(path: Path, key: str, value: str) -> None:
    """Gives a key of a TOML file another value."""
    text, count = re.subn(rf"(?m)^{key}\s*=\s*[^#\n]*", f"{key} = {value} ", path.read_text())
    if count != 1:
        raise ValueError(f"{path}: {key} occurs {count} times")
    path.write_text(text)


def read_number(path: Path, key: str) -> float:
    """The number that a key of a TOML file has."""
    found = re.search(rf"(?m)^{key}\s*=\s*([-+.\d]+)", path.read_text())
    if found is None:
        raise ValueError(f"{path}: no number {key}")
    return float(found[1])


def scale_column(path: Path, column: str, factor: float) -> None:
    """Multiplies a column of a CSV file."""
    lines = path.read_text().splitlines()
    index = lines[0].split(",").index(column)
    rows = [line.split(",") for line in lines[1:]]
    for row in rows:
        row[index] = f"{float(row[index]) * factor:.6f}"
    path.write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")


def use_small_field(folder: Path) -> None:
    """The league's 12 x 8 m field in place of the real one."""
    shutil.copy(ROOT / "config/fields/msl_12x8.toml", folder / "field.toml")


def narrow_field(folder: Path) -> None:
    """A field three metres too narrow."""
    field = folder / "field.toml"
    replace_value(field, "width", f"{read_number(field, 'width') - 3.0}")


def move_centre(folder: Path, du: float, dv: float) -> None:
    robot = folder / "robot.toml"
    found = re.search(r"(?m)^centre_px\s*=\s*\[\s*([-+.\d]+)\s*,\s*([-+.\d]+)", robot.read_text())
    if found is None:
        raise ValueError(f"{robot}: no centre_px")
    replace_value(robot, "centre_px", f"[{float(found[1]) + du}, {float(found[2]) + dv}]")


def shift_centre(folder: Path) -> None:
    """The mirror's centre five pixels off."""
    move_centre(folder, 4.0, -3.0)


def shift_centre_far(folder: Path) -> None:
    """The mirror's centre twenty pixels off: most points lie on markings, and the poses are 0.7 m off."""
    move_centre(folder, 20.0, 0.0)


def unflip(folder: Path) -> None:
    """The image taken for one that is not mirrored."""
    replace_value(folder / "robot.toml", "flipped", "false")


def turn_forward(folder: Path) -> None:
    """Forward taken for the image's right."""
    replace_value(folder / "robot.toml", "forward_deg", "0.0")


def compass_in_degrees(folder: Path) -> None:
    scale_column(folder / "compass.csv", "heading_rad", math.degrees(1.0))


def stamps_in_milliseconds(folder: Path) -> None:
    """The images' clock counts milliseconds."""
    table = "frames.csv" if (folder / "frames.csv").exists() else "points.csv"
    scale_column(folder / table, "stamp_s", 1000.0)


def turns_in_degrees(folder: Path) -> None:
    scale_column(folder / "odometry.csv", "dtheta_rad", math.degrees(1.0))


def raise_camera(folder: Path) -> None:
    """The camera 2 cm lower than robot.toml says."""
    robot = folder / "robot.toml"
    replace_value(robot, "height", f"{read_number(robot, 'height') + 0.02:.3f}")


def raise_camera_far(folder: Path) -> None:
    """The camera 5 cm lower than robot.toml says."""
    robot = folder / "robot.toml"
    replace_value(robot, "height", f"{read_number(robot, 'height') + 0.05:.3f}")


def turn_forward_slightly(folder: Path) -> None:
    robot = folder / "robot.toml"
    replace_value(robot, "forward_deg", f"{read_number(robot, 'forward_deg') - 10.0}")


def turn_forward_by_half_a_quarter(folder: Path) -> None:
    robot = folder / "robot.toml"
    replace_value(robot, "forward_deg", f"{read_number(robot, 'forward_deg') - 45.0}")


def path_in_centimetres(folder: Path) -> None:
    for column in ("dx_m", "dy_m"):
        scale_column(folder / "odometry.csv", column, 100.0)


def exchange_axes(folder: Path) -> None:
    """Forward and left of the wheels exchanged."""
    table = folder / "odometry.csv"
    header, *rows = table.read_text().splitlines()
    header = header.replace("dx_m", "?").replace("dy_m", "dx_m").replace("?", "dy_m")
    table.write_text("\n".join([header, *rows]) + "\n")


def right_is_positive(folder: Path) -> None:
    """The wheels count to the right, but turn counter-clockwise."""
    scale_column(folder / "odometry.csv", "dy_m", -1.0)


def turns_clockwise(folder: Path) -> None:
    scale_column(folder / "odometry.csv", "dtheta_rad", -1.0)


def odometry_turned_by_half(folder: Path) -> None:
    """The base looks backwards."""
    for column in ("dx_m", "dy_m"):
        scale_column(folder / "odometry.csv", column, -1.0)


def scale_wheels(folder: Path, factor: float) -> None:
    for column in ("dx_m", "dy_m", "dtheta_rad"):
        scale_column(folder / "odometry.csv", column, factor)


def half_of_the_motion(folder: Path) -> None:
    """The wheels are twice as large as the base believes."""
    scale_wheels(folder, 0.5)


def twice_the_motion(folder: Path) -> None:
    """The wheels are half as large as the base believes."""
    scale_wheels(folder, 2.0)


def compass_counts_clockwise(folder: Path) -> None:
    scale_column(folder / "compass.csv", "heading_rad", -1.0)


MISTAKES: dict[str, Callable[[Path], None]] = {
    "small_field": use_small_field,
    "narrow_field": narrow_field,
    "not_flipped": unflip,
    "forward_right": turn_forward,
    "compass_degrees": compass_in_degrees,
    "stamps_milliseconds": stamps_in_milliseconds,
    "turns_degrees": turns_in_degrees,
    "centre_off": shift_centre,
    "centre_far_off": shift_centre_far,
    "camera_raised": raise_camera,
    "camera_raised_far": raise_camera_far,
    "forward_slightly_off": turn_forward_slightly,
    "forward_off": turn_forward_by_half_a_quarter,
    "path_centimetres": path_in_centimetres,
    "axes_exchanged": exchange_axes,
    "right_positive": right_is_positive,
    "turns_clockwise": turns_clockwise,
    "odometry_turned": odometry_turned_by_half,
    "wheels_half": half_of_the_motion,
    "wheels_twice": twice_the_motion,
    "compass_clockwise": compass_counts_clockwise,
}


def make_folder(right: Path, mistake: str, folder: Path) -> Path:
    """Copies a right recording and makes one mistake in the copy. The images are linked."""
    folder.mkdir(parents=True)
    for file in right.iterdir():
        if file.is_dir():
            (folder / file.name).symlink_to(file.resolve())
        elif file.name != "poses.csv":
            (folder / file.name).write_bytes(file.read_bytes())
    MISTAKES[mistake](folder)
    return folder


if __name__ == "__main__":
    for name in MISTAKES:
        try:
            print(make_folder(Path(sys.argv[1]), name, Path(sys.argv[2]) / name))
        except (ValueError, FileNotFoundError, KeyError) as reason:
            print(f"{name}: does not apply ({reason})")
