"""Simulated runs of scenarios, on this machine or on another one that gets the run's files.

The run is computed in this process by the same functions as `mirrorball sim`: the same scenario, seed and settings give
the same estimates. Python's lock is released meanwhile, so that threads run scenarios side by side.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mirrorball import _core


@dataclass(frozen=True)
class Run:
    """A run to be made: scenario, seed, changed values. It can be sent to another machine as it is."""

    scenario: str
    """Path of the scenario inside `files`, or on this machine if there are none."""
    seed: int | None = None
    duration_s: float | None = None
    preset: str = "default"
    change: Mapping[str, Any] = field(default_factory=dict)
    """Values in place of the scenario's, by dotted key: {"path.speed": 2.0}."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Values in place of the preset's, by dotted key: {"localize.matching.steps_max": 20}."""
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)

    @property
    def key(self) -> str:
        """Content hash: runs with the same key have the same results."""
        settings = json.dumps(
            [self.scenario, self.seed, self.duration_s, self.preset, dict(self.change), dict(self.config)], sort_keys=True
        )
        digest = hashlib.sha256(settings.encode())
        for name, content in sorted(self.files.items()):
            digest.update(name.encode() + hashlib.sha256(content).digest())
        return digest.hexdigest()[:24]


def bundle_run(
    scenario: str | Path,
    *,
    seed: int | None = None,
    duration_s: float | None = None,
    preset: str = "default",
    change: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
) -> Run:
    """A run with all files that its scenario names, so that another machine can make it."""
    path = Path(scenario).resolve()
    contents = {Path(os.path.normpath(file)): Path(file).read_bytes() for file in _core.scenario_files(path)}
    root = Path(os.path.commonpath([file.parent for file in contents]))
    return Run(
        scenario=str(path.relative_to(root)),
        seed=seed,
        duration_s=duration_s,
        preset=preset,
        change=dict(change or {}),
        config=dict(config or {}),
        files={str(file.relative_to(root)): content for file, content in contents.items()},
    )


def simulate(
    run: Run | str | Path,
    *,
    record: str | Path | None = None,
    images: str = "png",
    progress: Callable[[float], object] | None = None,
    **options: Any,
) -> dict[str, Any]:
    """Makes a run and gives its summary: frames, modes, `position_error_m`, `heading_error_rad`, times, ball.

    A path stands for `Run(path, **options)`. `record` writes a log, with its images as "png", "jpeg" or "none".
    `progress` gets the simulated seconds some ten times a second; an exception that it raises ends the run.
    Raises FileNotFoundError for a missing file and ValueError for an invalid value.
    """
    if not isinstance(run, Run):
        run = Run(str(run), **options)
    elif options:
        raise TypeError(f"invalid options: {', '.join(options)} (expected none with a Run). Put them into the Run")
    if not run.files:
        return _simulate(run, Path(run.scenario), record, images, progress)
    with tempfile.TemporaryDirectory(prefix="mirrorball-") as folder:
        for name, content in run.files.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return _simulate(run, Path(folder, run.scenario), record, images, progress)


def _simulate(
    run: Run, scenario: Path, record: str | Path | None, images: str, progress: Callable[[float], object] | None
) -> dict[str, Any]:
    return _core.simulate(
        scenario,
        seed=run.seed,
        duration_s=run.duration_s,
        preset=run.preset,
        change=dict(run.change),
        config=dict(run.config),
        record=record,
        images=images,
        progress=progress,
    )
