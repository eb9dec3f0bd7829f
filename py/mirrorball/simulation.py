"""How does a robot fare in a scenario? One simulated run in one call, on this machine or wherever its files are sent.

The run is the executable's own (`mirrorball sim`): the same scenario, seed and settings give the same estimates.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

BUILD = Path(__file__).parents[2] / "target" / "release" / "mirrorball"
"""The executable of a build beside which this package lies."""

CARRIED = Path(__file__).parent / "bin" / "mirrorball"
"""The one that a wheel carries: without Python and windows, of the same version."""

PATHS = {"robot", "field", "profile", "file", "labels", "colours"}
"""Keys of scenario and robot files that name other files."""


@dataclass(frozen=True)
class Run:
    """A run to be made: which scenario, which seed, what is changed. It can be sent to another machine as it is."""

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
        """Tells runs apart: the same key, the same results."""
        said = json.dumps(
            [self.scenario, self.seed, self.duration_s, self.preset, dict(self.change), dict(self.config)], sort_keys=True
        )
        digest = hashlib.sha256(said.encode())
        for name, content in sorted(self.files.items()):
            digest.update(name.encode() + hashlib.sha256(content).digest())
        return digest.hexdigest()[:24]


def packed(
    scenario: str | Path,
    *,
    seed: int | None = None,
    duration_s: float | None = None,
    preset: str = "default",
    change: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
) -> Run:
    """A run with all files that its scenario names, so that another machine can make it."""
    found: dict[Path, bytes] = {}
    _gather(Path(scenario).resolve(), found)
    root = Path(os.path.commonpath([path.parent for path in found]))
    files = {str(path.relative_to(root)): content for path, content in found.items()}
    return Run(
        scenario=str(Path(scenario).resolve().relative_to(root)),
        seed=seed,
        duration_s=duration_s,
        preset=preset,
        change=dict(change or {}),
        config=dict(config or {}),
        files=files,
    )


def _gather(path: Path, found: dict[Path, bytes]) -> None:
    if path in found:
        return
    found[path] = path.read_bytes()
    if path.suffix == ".toml":
        for named in _named(tomllib.loads(found[path].decode())):
            _gather((path.parent / named).resolve(), found)


def _named(table: Mapping[str, Any]) -> list[str]:
    names = []
    for key, value in table.items():
        if isinstance(value, dict):
            names += _named(value)
        elif key in PATHS and isinstance(value, str):
            names.append(value)
    return names


def simulate(run: Run | str | Path, **options: Any) -> dict[str, Any]:
    """Makes a run and gives its summary: frames, modes, `position_error_m`, `heading_error_rad`, times, ball.

    A path stands for `Run(path, **options)`. Raises ValueError with the program's own words if it cannot be made.
    """
    if not isinstance(run, Run):
        run = Run(str(run), **options)
    if not run.files:
        return _execute(run, Path(run.scenario))
    with tempfile.TemporaryDirectory(prefix="mirrorball-") as folder:
        for name, content in run.files.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return _execute(run, Path(folder, run.scenario))


def program() -> str:
    """The executable: $MIRRORBALL, the one this Python runs in, the wheel's, the one on the PATH, or the build's beside it."""
    given = os.environ.get("MIRRORBALL")
    for candidate in (given, _embedding(), str(CARRIED), shutil.which("mirrorball"), str(BUILD)):
        if candidate and Path(candidate).is_file():
            return candidate
    raise FileNotFoundError("there is no executable mirrorball: put it on the PATH, or name it in $MIRRORBALL")


def _embedding() -> str | None:
    # Inside the executable, the package is carried by it.
    if __file__.startswith("<"):
        return str(Path("/proc/self/exe").readlink())
    return None


def _execute(run: Run, scenario: Path) -> dict[str, Any]:
    command = [program(), "sim", str(scenario), "--json", "--preset", run.preset]
    if run.seed is not None:
        command += ["--seed", str(run.seed)]
    if run.duration_s is not None:
        command += ["--duration", repr(float(run.duration_s))]
    for option, values in (("--set", run.change), ("--set-config", run.config)):
        for key, value in values.items():
            command += [option, f"{key}={as_toml(value)}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise ValueError(done.stderr.strip().removeprefix("mirrorball: ") or f"mirrorball ended with {done.returncode}")
    result: dict[str, Any] = json.loads(done.stdout)
    return result


def as_toml(value: Any) -> str:
    """A value as TOML writes it: bool, number, text, list or table."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(key)} = {as_toml(inner)}" for key, inner in value.items()) + " }"
    if hasattr(value, "tolist"):
        return as_toml(value.tolist())
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(as_toml, value)) + "]"
    raise ValueError(f"{value!r} has no form in TOML")
