"""Are many runs made once each, whatever fails meanwhile, and do they say what a single one says?"""

import json
import os
import runpy
import subprocess
from pathlib import Path

import pandas as pd
import pytest

import made_up_tasks
from conftest import PROGRAM, ROOT
from mirrorball.simulation import Run, as_toml, packed, simulate
from mirrorball.sweep import grid, sweep

SCENARIO = ROOT / "config/scenarios/tracks_18x12.toml"


def test_a_stopped_sweep_goes_on_with_what_is_missing(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    tasks = [{"value": float(value), "trace": str(trace)} for value in range(6)]
    first = sweep(tasks[:4], folder=tmp_path, function=made_up_tasks.square, workers=2, progress=False)
    assert first["square"].tolist() == [0.0, 1.0, 4.0, 9.0]
    whole = sweep(tasks, folder=tmp_path, function=made_up_tasks.square, workers=2, progress=False)
    assert whole["square"].tolist() == [0.0, 1.0, 4.0, 9.0, 16.0, 25.0]
    assert len(trace.read_text().splitlines()) == 6
    assert pd.read_parquet(tmp_path / "results.parquet")["square"].tolist() == whole["square"].tolist()


def test_what_fails_once_is_tried_again_and_what_cannot_be_says_why(tmp_path: Path) -> None:
    task = {"value": 0.0, "trace": str(tmp_path / "once")}
    found = sweep([task], folder=tmp_path / "a", function=made_up_tasks.fragile, workers=1, progress=False)
    assert found["error"].isna().all() and found["value"].tolist() == [1.0]
    found = sweep([task], folder=tmp_path / "b", function=made_up_tasks.hopeless, workers=1, progress=False)
    assert found["error"].tolist() == ["ValueError: no mirror for 0.0"]
    # A failure is not a result: the next sweep tries it anew.
    again = sweep([task], folder=tmp_path / "b", function=made_up_tasks.square, workers=1, progress=False)
    assert again["error"].isna().all()


def test_a_cluster_gives_the_same_rows(tmp_path: Path) -> None:
    from distributed import LocalCluster

    tasks = [{"value": float(value), "trace": str(tmp_path / "trace")} for value in range(3)]
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        found = sweep(tasks, folder=tmp_path, function=made_up_tasks.square, scheduler=address, progress=False)
    assert found["square"].tolist() == [0.0, 1.0, 4.0]


def test_runs_far_from_home_say_what_the_command_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    command: list[str | Path] = [
        PROGRAM,
        "sim",
        SCENARIO,
        "--json",
        "--seed",
        "5",
        "--duration",
        "0.5",
        "--set",
        "path.speed=0.5",
    ]
    said = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    monkeypatch.setenv("MIRRORBALL", str(PROGRAM))
    monkeypatch.chdir(tmp_path)
    runs = grid(SCENARIO, seeds=[5, 6], change={"path.speed": [0.5]}, duration_s=0.5)
    assert {Path(name).name for name in runs[0].files} >= {"tracks_18x12.toml", "default.toml", "msl_18x12.toml"}
    assert not any(str(ROOT) in name for name in runs[0].files) and runs[0].key != runs[1].key
    found = sweep(runs, folder=tmp_path, workers=2, progress=False)
    assert found["error"].isna().all() and found["asked_seed"].tolist() == [5, 6]
    assert found["position_error_m.mean"][0] == said["position_error_m"]["mean"]
    assert found["position_error_m.mean"][0] != found["position_error_m.mean"][1]


def test_a_run_that_cannot_be_made_says_why_in_the_programs_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIRRORBALL", str(PROGRAM))
    with pytest.raises(ValueError, match="speeed"):
        simulate(packed(SCENARIO, change={"path.speeed": 1.0}))
    with pytest.raises(ValueError, match="no_such"):
        simulate(Run("no_such.toml"))
    monkeypatch.setenv("MIRRORBALL", os.devnull + "/none")
    monkeypatch.setattr("shutil.which", lambda _: None)
    monkeypatch.setattr("mirrorball.simulation.BUILD", Path("/nowhere"))
    with pytest.raises(FileNotFoundError, match=r"\$MIRRORBALL"):
        simulate(SCENARIO)


def test_values_become_toml() -> None:
    assert as_toml([{"a": 1, "b": True}, "x", 2.5]) == '[{ "a" = 1, "b" = true }, "x", 2.5]'
    with pytest.raises(ValueError, match="no form"):
        as_toml(None)


def test_the_example_sweeps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIRRORBALL", str(PROGRAM))
    monkeypatch.setattr("sys.argv", ["sweep_speeds.py", str(tmp_path), "1", "0.3"])
    cells = runpy.run_path(str(ROOT / "py/examples/sweep_speeds.py"))
    assert cells["found"]["path.speed"].tolist() == [1.0, 3.0]
