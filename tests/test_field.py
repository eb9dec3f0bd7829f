"""`mirrorball field`: a drawing and a drive as field files."""

import json
import math
import subprocess
import tomllib
from pathlib import Path

from conftest import PROGRAM, ROOT


def field(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([PROGRAM, "field", *map(str, arguments)], capture_output=True, text=True)


def test_the_shipped_drawing_becomes_the_shipped_field(tmp_path: Path) -> None:
    folder = ROOT / "config/fields/drawn"
    out = tmp_path / "hall.toml"
    done = field("from-svg", folder / "taped_hall.svg", "--line-width", 0.05, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["lines"], result["arcs"], result["half_turn_symmetric"]) == (6, 2, False)
    assert tomllib.loads(out.read_text()) == tomllib.loads((folder / "taped_hall.toml").read_text())


def test_two_seconds_of_a_path_traced_drive_show_the_centre_circle_within_a_centimetre(tmp_path: Path) -> None:
    """The images are an independent renderer's. The drive passes the circle of 2 m radius, whose lines measure to centres."""
    out = tmp_path / "field.toml"
    done = field("from-recording", ROOT / "samples/sequence", "--tilt", 0.0, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert any("no place twice" in warning for warning in result["warnings"])
    found = tomllib.loads(out.read_text())
    arcs = [(radius, sweep) for _, _, radius, _, sweep in found["extra_arcs"]]
    assert any(abs(radius - 2.0) < 0.01 and sweep > 180.0 for radius, sweep in arcs), arcs
    # The circle's centre lies 6 m from the touch line.
    x, y, *_ = max(found["extra_arcs"], key=lambda arc: arc[4])
    distances = []
    for x0, y0, x1, y1 in found["extra_lines"]:
        length = math.hypot(x1 - x0, y1 - y0)
        if length > 5.0:
            distances.append(abs((x - x0) * (y1 - y0) - (y - y0) * (x1 - x0)) / length)
    assert any(abs(distance - 6.0) < 0.02 for distance in distances), distances


def test_what_cannot_be_mapped_is_refused_with_a_reason(tmp_path: Path) -> None:
    out = tmp_path / "field.toml"
    assert field("from-recording", tmp_path / "nobody", "--out", out).returncode == 2
    drawing = tmp_path / "bad.svg"
    drawing.write_text("<svg width='5' viewBox='0 0 5 5'><line x2='1'/></svg>")
    done = field("from-svg", drawing, "--out", out)
    assert done.returncode == 1 and "--scale" in done.stderr and "bad.svg" in done.stderr
    assert not out.exists()
