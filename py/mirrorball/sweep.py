"""Many runs: seeds, parameters or designs, on this machine or on a cluster, resumable.

>>> from mirrorball.sweep import grid, sweep
>>> runs = grid("config/scenarios/tracks_18x12.toml", seeds=range(20), change={"path.speed": [1.0, 2.0, 3.0]})  # doctest: +SKIP
>>> table = sweep(runs, folder="out/speeds")  # doctest: +SKIP

Needs `pip install mirrorball[analysis]`; a cluster needs `mirrorball[cluster]` (Dask distributed).
"""

from __future__ import annotations

import itertools
import json
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from numbers import Integral
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from tqdm import tqdm

from mirrorball._core import __version__
from mirrorball.arguments import checked, invalid, require_at_least
from mirrorball.simulation import FOLDER_PREFIX, Run, bundle_run, simulate
from mirrorball.task_keys import function_name, task_key
from mirrorball.task_pool import TaskPool

__all__ = ["grid", "sweep"]


def __dir__() -> list[str]:
    return __all__


Task = Any
Result = Mapping[str, Any]
Values = Sequence[Any] | NDArray[Any]

TEMPORARY_FOLDER = re.compile(rf"[^\s'\"]*{re.escape(FOLDER_PREFIX)}[^\s/'\"]+/")
"""Where the files of a run lie while it is made."""

FLUSH_PERIOD_S = 10.0
"""Longest time between two files of results, seconds."""


@checked
def grid(
    scenario: str | Path | Sequence[str | Path],
    *,
    seeds: Iterable[int] = (1,),
    presets: Sequence[str] = ("default",),
    change: Mapping[str, Values] | None = None,
    config: Mapping[str, Values] | None = None,
    duration_s: float | None = None,
) -> list[Run]:
    """Every combination of scenarios, presets, changed values and seeds, each run with the files it needs.

    `change` and `config` have a list or an array of values for each dotted key.

    ValueError for a seed that is negative or no whole number, TypeError for a single value in place of a list.
    """
    seeds = list(seeds)
    for seed in seeds:
        if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
            raise ValueError(invalid("seeds", seed, "whole numbers, at least 0"))
    scenarios = [scenario] if isinstance(scenario, str | Path) else scenario
    bases = [bundle_run(path, duration_s=duration_s) for path in scenarios]
    changes, configs = _combinations("change", change or {}), _combinations("config", config or {})
    return [
        replace(base, preset=preset, change=changed, config=configured, seed=seed)
        for base, preset, changed, configured, seed in itertools.product(bases, presets, changes, configs, seeds)
    ]


def _combinations(name: str, values: Mapping[str, Values]) -> list[dict[str, Any]]:
    for key, several in values.items():
        if not isinstance(several, Sequence | np.ndarray) or isinstance(several, str | bytes) or np.ndim(several) == 0:
            raise TypeError(invalid(f"{name}[{key!r}]", several, "a list of values"))
    return [dict(zip(values, chosen, strict=True)) for chosen in itertools.product(*values.values())]


def run_row(run: Run) -> dict[str, Any]:
    """Makes one run; its options and its summary as one flat row."""
    return _simulation_row(run)


def _simulation_row(run: Run, progress: Callable[[float], object] | None = None) -> dict[str, Any]:
    return _options_row(run) | flat(simulate(run, progress=progress))


def _options_row(run: Run) -> dict[str, Any]:
    row: dict[str, Any] = {"scenario": Path(run.scenario).stem, "preset": run.preset, "asked_seed": run.seed}
    return row | {key: value for key, value in (*run.change.items(), *run.config.items())}


def _row_text(task: Task, outcome: Any) -> str:
    """The row of a result, or of the exception in its place, as JSON."""
    if isinstance(outcome, Mapping):
        try:
            return json.dumps(dict(outcome), default=_json_default)
        except (TypeError, ValueError):
            # Keys that are no texts, or an entry that contains itself.
            pass
    if not isinstance(outcome, BaseException):
        expected = "a mapping of texts to numbers, texts and lists"
        outcome = TypeError(invalid("result of the function", outcome, expected))
    return json.dumps(_error_row(task, outcome), default=_json_default)


def _json_default(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _error_row(task: Task, error: BaseException) -> dict[str, Any]:
    """Why a task failed; of a run also what it was. Its files' folder is gone by then and says nothing."""
    text = f"{type(error).__name__}: {error}"
    if not isinstance(task, Run):
        return {"error": text}
    return _options_row(task) | {"error": TEMPORARY_FOLDER.sub("", text)}


def flat(result: Result, prefix: str = "") -> dict[str, Any]:
    """Nested results as one row: {"position_error_m": {"mean": 1}} becomes {"position_error_m.mean": 1}."""
    row: dict[str, Any] = {}
    for key, value in result.items():
        if isinstance(value, Mapping):
            row |= flat(value, f"{prefix}{key}.")
        else:
            row[f"{prefix}{key}"] = value
    return row


@checked
def sweep(
    tasks: Iterable[Task],
    *,
    folder: str | Path,
    function: Callable[[Task], Result] = run_row,
    workers: int | None = None,
    scheduler: str | None = None,
    retries: int = 2,
    progress: bool = True,
) -> pd.DataFrame:
    """Calls the function on each task and gives a row for each, in the order of the tasks.

    Rows are kept in `folder` as they come (rows-*.parquet); tasks whose rows are there already are not run again, so
    that a sweep that was stopped goes on. The whole table is results.parquet. Tasks are told apart by their content: plain
    data as JSON, other objects by what pickle stores of them. A folder belongs to one function, by its module and name, and
    to one version of this package. A function that changes under its name needs a new folder.

    A task that fails, or whose process dies, is tried `retries` times more (not after a ValueError or a missing file: it
    would fail again); a task that fails finally, or whose result is no mapping, is a row whose `error` says why, and is
    tried anew the next time. Tasks that were running beside one whose process died are repeated one by one. The row of a run
    keeps its scenario, preset, seed and changed values. `workers`: this machine's cores if None. `scheduler`: address of a
    Dask scheduler, whose workers need this package with its extras `analysis` and `cluster`.

    Functions other than the default must be importable by the workers (defined in a module).

    ValueError for a function without a name in a module, and for a folder with rows of another function or version.
    """
    if workers is not None:
        require_at_least("workers", workers, 1)
    require_at_least("retries", retries, 0)
    tasks = list(tasks)
    folder = Path(folder)
    keys = [task_key(task) for task in tasks]
    origin = {"function": function_name(function), "version": __version__}
    known = {key for key, row in _read_rows(folder, origin).items() if row.get("error") is None}
    todo = {key: task for key, task in zip(keys, tasks, strict=True) if key not in known}
    folder.mkdir(parents=True, exist_ok=True)
    if todo:
        writer = _RowWriter(folder, origin)
        outcomes = (
            _run_on_cluster(function, todo, scheduler, retries) if scheduler else _run_locally(function, todo, workers, retries)
        )
        bar = tqdm(outcomes, total=len(keys), initial=len(keys) - len(todo), unit="run", disable=not progress)
        try:
            for key, outcome in bar:
                writer.add(key, _row_text(todo[key], outcome))
        finally:
            writer.flush()
    stored = _read_rows(folder, origin)
    table = pd.DataFrame([stored[key] for key in keys if key in stored])
    table.to_parquet(folder / "results.parquet", index=False)
    return table


def _run_locally(
    function: Callable[[Task], Result], todo: dict[str, Task], workers: int | None, retries: int
) -> Iterator[tuple[str, Any]]:
    stop = Event()
    # A simulation releases Python's lock, so that threads suffice; other functions get processes.
    open_executor: Callable[[int], Executor] = ThreadPoolExecutor if function is run_row else ProcessPoolExecutor
    if function is run_row:
        function = partial(_simulation_row, progress=partial(_raise_if_set, stop))
    pool = TaskPool(function, todo, open_executor=open_executor, retries=retries, stop=stop)
    return pool.outcomes(workers or len(os.sched_getaffinity(0)))


def _raise_if_set(stop: Event, _seconds: float) -> None:
    # Signals reach the main thread alone: runs in other threads end by this exception.
    if stop.is_set():
        raise InterruptedError("the sweep was stopped")


def _run_on_cluster(
    function: Callable[[Task], Result], todo: dict[str, Task], scheduler: str, retries: int
) -> Iterator[tuple[str, Any]]:
    from distributed import Client
    from distributed import as_completed as finished

    with Client(scheduler) as client:
        # Sweeps of other functions may have equal tasks, and the scheduler serves all of them.
        keys = {f"{function_name(function)}-{key}": key for key in todo}
        futures = client.map(function, list(todo.values()), key=list(keys), retries=retries, pure=False)
        for future in finished(futures):
            error = future.exception()
            yield keys[future.key], future.result() if error is None else error
            future.release()


class _RowWriter:
    """Rows to Parquet: a new file each few seconds, complete under its name or not there."""

    def __init__(self, folder: Path, origin: Mapping[str, str]) -> None:
        self.folder = folder
        self.origin = origin
        self.rows: list[dict[str, str]] = []
        self.last_flush = time.monotonic()

    def add(self, key: str, row: str) -> None:
        self.rows.append({"key": key, "row": row, **self.origin})
        if time.monotonic() - self.last_flush >= FLUSH_PERIOD_S:
            self.flush()

    def flush(self) -> None:
        self.last_flush = time.monotonic()
        if not self.rows:
            return
        number = 1 + max((int(path.stem.rpartition("-")[2]) for path in self.folder.glob("rows-*.parquet")), default=0)
        path = self.folder / f"rows-{number:06d}.parquet"
        part = path.with_suffix(".part")
        pq.write_table(pa.Table.from_pylist(self.rows), part)
        part.rename(path)
        self.rows = []


def _read_rows(folder: Path, origin: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Rows by key; of several the last. ValueError if they have another origin: a function and a version."""
    rows: dict[str, dict[str, Any]] = {}
    for path in sorted(folder.glob("rows-*.parquet")):
        for stored in pq.read_table(path).to_pylist():
            found = {name: stored.get(name) for name in origin}
            if found != origin:
                problem = f"invalid folder: {str(folder)!r} has rows of {_origin_text(found)}"
                raise ValueError(f"{problem} (expected rows of {_origin_text(origin)}). Use another folder")
            rows[stored["key"]] = {"error": None, **json.loads(stored["row"])}
    return rows


def _origin_text(origin: Mapping[str, str | None]) -> str:
    if origin["function"] is None:
        return "an unknown function by an earlier mirrorball"
    return f"{origin['function']} by mirrorball {origin['version']}"
