"""Simulated runs in process and sweeps: the same results as the command line, each run once, failures recorded."""

import json
import os
import pickle
import runpy
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import mirrorball
import sweep_tasks
from conftest import PROGRAM, ROOT
from mirrorball.estimates import Pose
from mirrorball.log import Log
from mirrorball.mirror import lima2001
from mirrorball.simulation import Run, bundle_run
from mirrorball.sweep import grid, sweep
from mirrorball.task_keys import function_name, task_key

SCENARIO = ROOT / "config/scenarios/tracks_18x12.toml"


def test_interrupted_sweep_resumes_with_missing_tasks(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    tasks = [{"value": float(value), "trace": str(trace)} for value in range(6)]
    first = sweep(tasks[:4], folder=tmp_path, function=sweep_tasks.square, workers=2, progress=False)
    assert first["square"].tolist() == [0.0, 1.0, 4.0, 9.0]
    whole = sweep(tasks, folder=tmp_path, function=sweep_tasks.square, workers=2, progress=False)
    assert whole["square"].tolist() == [0.0, 1.0, 4.0, 9.0, 16.0, 25.0]
    assert len(trace.read_text().splitlines()) == 6
    assert pd.read_parquet(tmp_path / "results.parquet")["square"].tolist() == whole["square"].tolist()


def test_failed_task_is_retried_and_value_error_recorded(tmp_path: Path) -> None:
    task = {"value": 0.0, "trace": str(tmp_path / "once")}
    found = sweep([task], folder=tmp_path / "a", function=sweep_tasks.fragile, workers=1, progress=False)
    assert found["error"].isna().all() and found["value"].tolist() == [1.0]
    found = sweep([task], folder=tmp_path / "b", function=sweep_tasks.hopeless, workers=1, progress=False)
    assert found["error"].tolist() == ["ValueError: no mirror for 0.0"]
    # A failure is not a result: the next sweep tries it anew.
    fragile = partial(
        sweep, [{"value": 0.0, "trace": str(tmp_path / "later")}], folder=tmp_path / "c", retries=0, progress=False
    )
    assert fragile(function=sweep_tasks.fragile)["error"].tolist() == ["OSError: the disk hiccuped"]
    assert fragile(function=sweep_tasks.fragile)["error"].isna().all()


@pytest.mark.parametrize("workers", [1, 3])
def test_task_whose_process_dies_is_a_row_and_the_others_run(workers: int, tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    tasks = [{"value": value, "trace": str(trace)} for value in (1.0, -2.0, 3.0, 4.0, 5.0, 6.0)]
    found = sweep(tasks, folder=tmp_path, function=sweep_tasks.deadly, workers=workers, retries=1, progress=False)
    assert found["square"].drop(1).tolist() == [1.0, 9.0, 16.0, 25.0, 36.0]
    assert found["error"].drop(1).isna().all() and found["error"][1].startswith("BrokenProcessPool")
    # Beside other running tasks, the first death is not known to be its own.
    assert trace.read_text().split().count("-2.0") in ((2,) if workers == 1 else (2, 3))


def test_task_whose_process_dies_once_is_repeated(tmp_path: Path) -> None:
    task = {"value": 0.0, "trace": str(tmp_path / "once")}
    found = sweep([task], folder=tmp_path, function=sweep_tasks.deadly_once, retries=1, progress=False)
    assert found["error"].isna().all() and found["value"].tolist() == [1.0]


def test_result_that_is_no_row_is_an_error(tmp_path: Path) -> None:
    found = sweep([5, {(1, 2): 3.0}, {"a": 1}], folder=tmp_path, function=sweep_tasks.bare, workers=1, progress=False)
    assert (
        found["error"][0]
        == "TypeError: invalid result of the function: 5 (expected a mapping of texts to numbers, texts and lists)"
    )
    assert "(1, 2)" in found["error"][1] and found["a"][2] == 1


def test_folder_of_another_function_or_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tasks = [{"value": 2.0, "trace": str(tmp_path / "trace")}]
    sweep(tasks, folder=tmp_path, function=sweep_tasks.square, workers=1, progress=False)
    with pytest.raises(ValueError, match=r"invalid folder: .*sweep_tasks\.square by .*expected rows of sweep_tasks\.deadly by"):
        sweep(tasks, folder=tmp_path, function=sweep_tasks.deadly, workers=1, progress=False)
    with monkeypatch.context() as patch:
        patch.setattr("mirrorball.sweep.__version__", "99.0.0")
        with pytest.raises(ValueError, match=r"expected rows of sweep_tasks\.square by mirrorball 99\.0\.0\)"):
            sweep(tasks, folder=tmp_path, function=sweep_tasks.square, workers=1, progress=False)
    old = tmp_path / "old"
    old.mkdir()
    pd.DataFrame([{"key": "1", "row": "{}"}]).to_parquet(old / "rows-000001.parquet")
    with pytest.raises(ValueError, match="unknown function by an earlier mirrorball"):
        sweep(tasks, folder=old, function=sweep_tasks.square, workers=1, progress=False)


def test_equal_tasks_have_equal_keys() -> None:
    name = "abc"
    equal = [
        ([name, name], json.loads('["abc", "abc"]')),
        ({"a": 1, "b": (2.0, None)}, {"b": [2.0, None], "a": 1}),
        ({"seed": np.int64(3), "scale": np.array([1.0, 2.0])}, {"seed": 3, "scale": [1.0, 2.0]}),
        ({"x", "y", "z"}, {"z", "y", "x"}),
        (Pose(1.0, 2.0, 0.5), Pose(*np.array([1.0, 2.0, 0.5]))),
        (lima2001(), pickle.loads(pickle.dumps(lima2001()))),
        (partial(sweep_tasks.square, {"value": 1.0}), partial(sweep_tasks.square, {"value": 1.0})),
    ]
    for first, second in equal:
        assert task_key(first) == task_key(second), first
    different = [1, 1.0, "1", None, [], [1], {1: 2}, {"1": 2}, {1}, b"1", Pose(1.0, 2.0, 0.5), [1.0, 2.0, 0.5], int, lima2001()]
    assert len({task_key(task) for task in different}) == len(different)


def test_function_is_named_by_its_module(monkeypatch: pytest.MonkeyPatch) -> None:
    assert function_name(sweep_tasks.square) == "sweep_tasks.square"
    # A script's function is the same as where the script is imported.
    monkeypatch.setattr(sweep_tasks.square, "__module__", "__main__")
    monkeypatch.setattr(sys.modules["__main__"], "__file__", "/somewhere/sweep_tasks.py")
    assert function_name(sweep_tasks.square) == "sweep_tasks.square"
    names = {function_name(partial(sweep_tasks.bare, value)) for value in (1, 2)}
    assert len(names) == 2 and all(name.startswith("functools.partial ") for name in names)
    with pytest.raises(ValueError, match=r"invalid function: .*one that a module defines under a name"):
        function_name(lambda task: task)


def test_dask_cluster_gives_the_same_rows(tmp_path: Path) -> None:
    from distributed import LocalCluster

    tasks = [{"value": float(value), "trace": str(tmp_path / "trace")} for value in range(3)]
    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster:
        address = cluster.scheduler_address
        found = sweep(tasks, folder=tmp_path, function=sweep_tasks.square, scheduler=address, progress=False)
    assert found["square"].tolist() == [0.0, 1.0, 4.0]


def test_two_sweeps_on_one_cluster_get_their_own_results(tmp_path: Path) -> None:
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, dashboard_address=None) as cluster:

        def result(function: Any) -> float:
            folder = tmp_path / function.__name__
            found = sweep([3.0], folder=folder, function=function, scheduler=cluster.scheduler_address, progress=False)
            return float(found["value"][0])

        with ThreadPoolExecutor(2) as pool:
            assert list(pool.map(result, [sweep_tasks.slow_square, sweep_tasks.slow_cube])) == [9.0, 27.0]


TIMES = ("see_ms", "localize_ms", "times_real_time")


def command_line_summary(*options: str) -> dict[str, Any]:
    command: list[str | Path] = [PROGRAM, "sim", SCENARIO, "--json", *options]
    summary: dict[str, Any] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return {key: value for key, value in summary.items() if key not in TIMES}


def test_bundled_run_matches_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    printed = command_line_summary("--seed", "5", "--duration", "0.5", "--set", "path.speed=0.5")
    monkeypatch.chdir(tmp_path)
    runs = grid(SCENARIO, seeds=[5, 6], change={"path.speed": [0.5]}, duration_s=0.5)
    assert {Path(name).name for name in runs[0].files} >= {"tracks_18x12.toml", "default.toml", "msl_18x12.toml"}
    assert not any(str(ROOT) in name for name in runs[0].files) and runs[0].key != runs[1].key
    found = sweep(runs, folder=tmp_path, workers=2, progress=False)
    assert found["error"].isna().all() and found["asked_seed"].tolist() == [5, 6]
    assert found["position_error_m.mean"][0] == printed["position_error_m"]["mean"]
    assert found["position_error_m.mean"][0] != found["position_error_m.mean"][1]


def test_simulation_in_process_matches_the_command_line_and_its_log_verifies(tmp_path: Path) -> None:
    printed = command_line_summary("--seed", "5", "--duration", "0.5", "--preset", "nubot2013",
                                   "--set-config", "localize.matching.steps_max=9")  # fmt: skip
    log = tmp_path / "game.mcap"
    seconds: list[float] = []
    found = mirrorball.simulate(SCENARIO, seed=5, duration_s=0.5, preset="nubot2013",
                                config={"localize.matching.steps_max": np.int64(9)}, record=log,
                                progress=seconds.append)  # fmt: skip
    assert {key: value for key, value in found.items() if key not in TIMES} == printed
    assert seconds == sorted(seconds)
    subprocess.run([PROGRAM, "replay", log, "--verify"], check=True, capture_output=True)


def test_several_robots_are_simulated(tmp_path: Path) -> None:
    found = mirrorball.simulate(ROOT / "config/scenarios/squad.toml", duration_s=0.2, record=tmp_path / "game.mcap")
    assert [robot["robot"] for robot in found["robots"]] == list(range(1, 1 + len(found["robots"])))
    assert Log(tmp_path / "game.mcap").complete and Log(tmp_path / "game-2.mcap").complete


def test_ball_that_is_never_found_has_no_error(tmp_path: Path) -> None:
    # A covered mirror shows no ball.
    covered = {"start": 0.0, "stop": 9.0, "direction_deg": 0.0, "width_deg": 360.0}
    change = {"occlusions": [covered], "ball.position": [-5.0, -4.0]}
    found = mirrorball.simulate(SCENARIO, duration_s=0.2, change=change)
    assert found["ball"]["found"] == 0 and found["ball"]["error_m"] is None
    table = sweep([mirrorball.Run(str(SCENARIO), duration_s=0.2, change=change)], folder=tmp_path, progress=False)
    assert table["ball.error_m"].isna().all() and table["ball.found"].eq(0).all()


def test_team_is_refused_where_one_robot_is_simulated(tmp_path: Path) -> None:
    squad = ROOT / "config/scenarios/squad.toml"
    with pytest.raises(ValueError, match=r"squad: 4 more robots .*mirrorball\.simulate"):
        mirrorball.Simulation(squad)
    alone = mirrorball.Simulation(squad, change={"squad": []}, images=False)
    assert alone.step().truth.pose.x_m == pytest.approx(-4.6, abs=0.05)
    done = subprocess.run([PROGRAM, "sim", squad, "--hardware", tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "squad: 4 more robots" in done.stderr, done.stderr


def test_simulations_in_threads_give_the_same_results() -> None:
    def error(_: int) -> float:
        return float(mirrorball.simulate(SCENARIO, seed=5, duration_s=0.3)["position_error_m"]["mean"])

    with ThreadPoolExecutor(2) as pool:
        assert len(set(pool.map(error, range(2)))) == 1


def test_interrupted_simulation_leaves_a_complete_log(tmp_path: Path) -> None:
    code = (
        f"import mirrorball; mirrorball.simulate({str(SCENARIO)!r}, duration_s=600.0, record={str(tmp_path / 'game.mcap')!r})"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "py")}
    program = [sys.executable, "-c", code]
    # A shell's background jobs ignore the interrupt, and so would this one.
    heed = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    with subprocess.Popen(program, env=environment, stderr=subprocess.PIPE, text=True, preexec_fn=heed) as running:
        # A simulation's log gets its name when it is complete.
        part = tmp_path / f"game.mcap.{running.pid}.part"
        while running.poll() is None and (not part.exists() or part.stat().st_size < 1_000_000):
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=60)
    assert "KeyboardInterrupt" in errors
    assert Log(tmp_path / "game.mcap").complete


def test_simulation_that_is_broken_off_leaves_an_earlier_log(tmp_path: Path) -> None:
    log = tmp_path / "drive.mcap"
    mirrorball.simulate(SCENARIO, duration_s=1.0, record=log)
    before = log.read_bytes()

    def stop(seconds: float) -> None:
        if seconds > 0.5:
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        mirrorball.simulate(SCENARIO, duration_s=2.0, record=log, progress=stop)
    assert log.read_bytes() == before
    assert list(tmp_path.iterdir()) == [log]


def test_invalid_runs_raise_errors_with_their_reasons(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="speeed"):
        mirrorball.simulate(bundle_run(SCENARIO, change={"path.speeed": 1.0}))
    with pytest.raises(ValueError, match=r"path\.speed: None"):
        mirrorball.simulate(SCENARIO, change={"path.speed": None})
    with pytest.raises(ValueError, match="no_such_preset"):
        mirrorball.simulate(SCENARIO, preset="no_such_preset")
    with pytest.raises(ValueError, match=r"invalid duration_s: nan \(expected a finite number\)"):
        mirrorball.simulate(SCENARIO, duration_s=float("nan"))
    with pytest.raises(ValueError, match=r"invalid images: 'bmp' \(expected 'png', 'jpeg', 'none'\)"):
        mirrorball.simulate(SCENARIO, images="bmp")  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="'sed'"):
        mirrorball.simulate(SCENARIO, sed=3)  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="invalid options: seed"):
        mirrorball.simulate(Run(str(SCENARIO)), seed=3)
    with pytest.raises(FileNotFoundError, match="no_such"):
        mirrorball.simulate(Run("no_such.toml"))
    found = sweep([Run("no_such.toml")], folder=tmp_path, workers=1, progress=False)
    assert "FileNotFoundError" in found["error"][0]


def test_bundled_run_holds_mask_and_labels(tmp_path: Path) -> None:
    robot = (ROOT / "config/robots/default.toml").read_text().replace('"../', f'"{ROOT}/config/')
    (tmp_path / "robot.toml").write_text('mask = "mask.png"\n' + robot)
    (tmp_path / "labels.csv").write_text("file,u,v,class\nimage.png,1,2,ball\n")
    for name in ("mask.png", "image.png"):
        (tmp_path / name).write_bytes(b"")
    scenario = SCENARIO.read_text().replace("../robots/default.toml", "robot.toml").replace('"../', f'"{ROOT}/config/')
    (tmp_path / "scenario.toml").write_text(scenario)
    names = {Path(name).name for name in bundle_run(tmp_path / "scenario.toml").files}
    assert {"scenario.toml", "robot.toml", "mask.png", "labels.csv", "image.png"} <= names


def test_numpy_seeds_and_values_are_as_good_as_pythons(tmp_path: Path) -> None:
    def runs(seeds: Any, speeds: Any, scales: Any, steps: Any) -> list[Run]:
        change = {"path.speed": speeds, "wheels.radius_scale": scales}
        return grid(SCENARIO, seeds=seeds, change=change, config={"localize.matching.steps_max": steps}, duration_s=0.5)

    arrays = runs(np.arange(1, 3), np.linspace(1.0, 2.0, 2), [np.array([1.02, 1.0, 1.0])], np.array([20]))
    lists = runs([1, 2], [1.0, 2.0], [[1.02, 1.0, 1.0]], [20])
    assert [run.key for run in arrays] == [run.key for run in lists]
    found = sweep(arrays[:1], folder=tmp_path, progress=False)
    assert found["error"].isna().all() and found["asked_seed"].tolist() == [1]


def test_failed_run_keeps_its_options_beside_the_error(tmp_path: Path) -> None:
    runs = grid(SCENARIO, seeds=[7], presets=["nubot2013"], change={"path.speed": [-1.0]}, duration_s=0.5)
    row = sweep(runs, folder=tmp_path, progress=False).iloc[0]
    assert (row["scenario"], row["preset"], row["asked_seed"], row["path.speed"]) == ("tracks_18x12", "nubot2013", 7, -1.0)
    assert "speed" in row["error"] and "/tmp" not in row["error"] and "mirrorball-" not in row["error"]


def test_sweep_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["sweep_speeds.py", str(tmp_path), "1", "0.3"])
    cells = runpy.run_path(str(ROOT / "py/examples/sweep_speeds.py"))
    assert cells["found"]["path.speed"].tolist() == [1.0, 3.0]


@pytest.mark.parametrize(("name", "value", "least"), [("workers", 0, 1), ("workers", -1, 1), ("retries", -1, 0)])
def test_counts_of_a_sweep_are_refused_by_name(name: str, value: int, least: int, tmp_path: Path) -> None:
    options: dict[str, Any] = {name: value}
    with pytest.raises(ValueError, match=rf"invalid {name}: {value} \(expected at least {least}\)"):
        sweep([1], folder=tmp_path, function=sweep_tasks.bare, progress=False, **options)


@pytest.mark.parametrize("name", ["change", "config"])
@pytest.mark.parametrize("single", [2.0, "ab", np.float64(2.0), np.array(2.0), {"a": 1}])
def test_single_value_in_place_of_a_list_is_refused_by_name(name: str, single: Any) -> None:
    options: dict[str, Any] = {name: {"path.speed": single}}
    with pytest.raises(TypeError, match=rf"invalid {name}\['path.speed'\]: .*\(expected a list of values\)"):
        grid(SCENARIO, **options)


def test_negative_seed_is_rejected_before_any_run() -> None:
    with pytest.raises(ValueError, match=r"invalid seeds: -1 \(expected whole numbers, at least 0\)"):
        grid(SCENARIO, seeds=[1, -1])
