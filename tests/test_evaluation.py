"""`mirrorball eval` on a small experiment of every kind of part."""

import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from conftest import PROGRAM, ROOT

SMALL_EXPERIMENT = """
title = "Small"
source = "nobody"
differs = ["It is small."]
seeds = 2

[[parts]]
name = "drives"
title = "Drives"
[parts.run.drives]
scenario = "{root}/config/scenarios/tracks_18x12.toml"
presets = ["default"]
[[parts.run.drives.variants]]
name = "open, lit"
set = {{ duration = 0.7 }}
[[parts.run.drives.variants]]
name = "covered"
[parts.run.drives.variants.set]
duration = 0.7
occlusions = [{{ start = 0.0, stop = 9.0, direction_deg = 0.0, width_deg = 360.0 }}]
[[parts.paper]]
variant = "open, lit"
figure = "mean |x|, cm"
value = 5.907
place = "table 1"

[[parts]]
name = "stills"
title = "Stills"
[parts.run.stills]
scenario = "{root}/config/scenarios/stills_2001.toml"
presets = ["default"]
spots = [[-1.0, 0.5], [2.0, -1.0]]
headings_deg = [30.0]

[[parts]]
name = "times"
title = "Times"
[parts.run.times]
field = "{root}/config/fields/msl_18x12.toml"
cycles = 5
stages = ["line_points", "monte_carlo", "matching_rprop", "matching", "scan_map_global", "scan_map_local", "hough", "exact"]

[[parts]]
name = "searches"
title = "Searches"
[parts.run.searches]
field = "{root}/config/fields/msl_18x12.toml"
presets = ["default", "minho2016"]
count = 10
compass_std_deg = 5.0

[[parts]]
name = "landscape"
title = "Landscape"
[parts.run.landscape]
field = "{root}/config/fields/msl_18x12.toml"
pose = [-3.24, 1.73, 30.0]
step = 0.2
reach = 0.25

[[parts]]
name = "eyes"
title = "Eyes"
[parts.run.eyes]
presets = ["default"]
recordings = [{{ name = "recorded", folder = "{root}/samples/sequence" }}]
variants = [{{ name = "played", scenario = "{root}/config/scenarios/demo.toml", set = {{ duration = 1.5 }} }}]

[[parts]]
name = "fusion"
title = "Fusion"
[parts.run.fusion]
robot = "{root}/config/robots/default.toml"
courses = ["plain"]
estimators = ["joint", "odometry"]
duration = 8.0

[[parts]]
name = "team"
title = "Team"
[parts.run.team]
variants = [{{ name = "usual", seconds = 5.0 }}, {{ name = "a liar", liars = 1, seconds = 5.0 }}]

[[parts]]
name = "squad"
title = "Squad"
[parts.run.squad]
presets = ["default"]
variants = [{{ name = "squad", scenario = "{root}/config/scenarios/squad.toml", set = {{ duration = 1.5 }} }}]

[[parts]]
name = "certificates"
title = "Certificates"
[parts.run.certificates]
field = "{root}/config/fields/msl_18x12.toml"
starts = 20
variants = [{{ name = "5 m", range_max = 5.0, blocks = 1000 }}, {{ name = "none", range_max = 5.0, blocks = 0 }}]

[[parts]]
name = "certainty"
title = "Certainty"
[parts.run.certainty]
field = "{root}/config/fields/msl_18x12.toml"
speed = 1.0
seconds = 1.0
standing = 0.2
behaviours = ["stand", "advice"]
variants = [{{ name = "1.5 m", range_max = 1.5 }}]

[[parts]]
name = "mapping"
title = "Mapping"
[parts.run.mapping]
variants = [{{ name = "hall", field = "{root}/config/fields/drawn/taped_hall.toml", seconds = 15.0 }}]
"""


def evaluate(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "VIRTUAL_ENV": sys.prefix}
    return subprocess.run([PROGRAM, "eval", *map(str, arguments)], capture_output=True, text=True, env=environment)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("small")
    (folder / "small.toml").write_text(SMALL_EXPERIMENT.format(root=ROOT))
    done = evaluate(folder / "small.toml", "--out", folder / "out", "--json")
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_every_experiment_kind_gives_rows_and_html(result: dict[str, Any]) -> None:
    figures = {(part["name"], one["variant"], one["method"], one["name"]): one
               for part in result["parts"] for one in part["figures"]}  # fmt: skip
    open_x = figures["drives", "open, lit", "default", "mean |x|, cm"]
    assert open_x["value"] < 2.0 and open_x["paper"] == {"value": 5.907, "until": None, "place": "table 1"}
    assert open_x["interval"]["low"] <= open_x["value"] <= open_x["interval"]["high"]
    # A covered camera from the start: nothing to go by, and no number that pretends.
    assert figures["drives", "covered", "default", "lost, % of frames"]["value"] > 95.0
    assert figures["drives", "covered", "default", "mean |x|, cm"]["paper"] is None
    assert figures["stills", "", "default", "within 0.5 m, %"]["value"] == 100.0
    assert figures["searches", "", "default", "right, %"]["value"] >= 90.0
    assert figures["landscape", "", "error surface", "lowest cell from the truth, cm"]["value"] < 30.0
    for source in ("recorded", "played"):
        right = figures["eyes", source, "default", "line points right (5 m), %"]
        assert right["value"] > 95.0 and right["interval"]["low"] <= right["value"] <= right["interval"]["high"]
        assert figures["eyes", source, "default", "ball found (6 m), %"]["value"] > 80.0
    joint, wheels = (figures["fusion", "plain", name, "mean position, cm"]["value"] for name in ("joint", "odometry"))
    assert joint < 2.0 and wheels > 3.0 * joint and figures["fusion", "plain", "joint", "NEES (3 is honest)"]["value"] > 0.5
    alone, team = (figures["team", "usual", name, "error of the ball, cm"]["value"] for name in ("best robot", "team"))
    assert 1.0 < team < alone < 40.0 and ("squad", "squad", "team", "error of the ball, cm") in figures
    page = Path(result["page"]).read_text()
    bound, loose = (
        figures["certificates", name, "exact", "no other pose explains more than, %"]["value"] for name in ("5 m", "none")
    )
    assert 20.0 < bound < loose <= 100.0
    assert figures["mapping", "hall", "mapped", "error of the markings, root mean square, cm"]["value"] < 5.0
    # Places that are ambiguous at first, and therefore drawn, depend on the seeds.
    assert page.count("<img") in (14, 15) and "5.907 (table 1)" in page and "It is small." in page


def test_equal_seeds_give_equal_rows_on_any_thread_count(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL_EXPERIMENT.format(root=ROOT))
    rows = []
    for number, threads in (("1", "1"), ("2", "2")):
        os.environ["RAYON_NUM_THREADS"] = threads
        done = evaluate(tmp_path / "small.toml", "--out", tmp_path / number, "--only", "drives", "--seed", "7")
        del os.environ["RAYON_NUM_THREADS"]
        assert done.returncode == 0, done.stderr
        rows.append((tmp_path / number / "drives.csv").read_bytes())
    assert rows[0] == rows[1] and len(rows[0].splitlines()) == 1 + 2 * 2 * 21


def test_invalid_experiments_are_rejected(tmp_path: Path) -> None:
    (tmp_path / "bad.toml").write_text(SMALL_EXPERIMENT.format(root=ROOT).replace('["default"]', '["defualt"]', 1))
    done = evaluate(tmp_path / "bad.toml", "--out", tmp_path)
    assert done.returncode == 1 and 'unknown preset: "defualt"' in done.stderr and "drives" in done.stderr
    assert evaluate("nobody1999", "--out", tmp_path).returncode == 1
    assert evaluate("lima2001", "--out", tmp_path, "--only", "nothing").returncode == 2


def test_shipped_experiments_name_existing_files_and_metrics(result: dict[str, Any]) -> None:
    names = {one["name"] for part in result["parts"] for one in part["figures"]}
    methods = {one["method"] for part in result["parts"] for one in part["figures"]} | {"lima2001", "nubot2013"}
    folder = ROOT / "config/experiments"
    assert {
        "air",
        "all",
        "certainty",
        "cooperative",
        "eyes",
        "fusion",
        "lima2001",
        "mapping",
        "minho2016",
        "nubot2013",
        "team",
    } <= {path.stem for path in folder.glob("*.toml")}
    for path in folder.glob("*.toml"):
        for part in tomllib.loads(path.read_text())["parts"]:
            (run,) = part["run"].values()
            variants = run.get("variants", [])
            for named in (
                run.get("scenario"),
                run.get("field"),
                run.get("robot"),
                *(one.get("scenario") for one in variants),
                *(one.get("field") for one in variants),
            ):
                assert named is None or (folder / named).is_file(), (path, named)
            for recording in run.get("recordings", []):
                assert (folder / recording["folder"] / "truth.csv").is_file(), (path, recording)
            for stated in part.get("paper", []):
                assert stated["figure"] in names, (path, stated)
                known = methods | {one["name"] for one in variants}
                assert stated.get("variant", "default") in known, (path, stated)
