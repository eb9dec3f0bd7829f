"""Simulated runs of scenarios: whole ones, or sample by sample with the caller at the wheel.

`simulate` makes a run, on this machine or on another one that gets the run's files. `Simulation` gives samples and takes
commands. Both compute in this process by the functions of `mirrorball sim`: the same scenario, seed and settings give the same
estimates. Python's lock is released meanwhile, so that threads run scenarios side by side.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mirrorball import _core
from mirrorball.arguments import Number, Vector, Whole, checked, invalid, plain
from mirrorball.estimates import Cycle
from mirrorball.pipeline import Config, Pipeline
from mirrorball.samples import ImageSample, Sample, TruthSample, sample_from_core

__all__ = ["Run", "Simulation", "Step", "bundle_run", "simulate"]


def __dir__() -> list[str]:
    return __all__


FOLDER_PREFIX = "mirrorball-"
"""How the temporary folder of a run's files begins."""


@checked
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

    def __post_init__(self) -> None:
        for name in ("seed", "duration_s", "change", "config"):
            object.__setattr__(self, name, plain(getattr(self, name)))

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


@checked
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


@checked
def simulate(
    run: Run | str | Path,
    *,
    seed: Whole | None = None,
    duration_s: Number | None = None,
    preset: str | None = None,
    change: Mapping[str, Any] | None = None,
    config: Mapping[str, Any] | None = None,
    record: str | Path | None = None,
    images: Literal["png", "jpeg", "none"] = "png",
    progress: Callable[[float], object] | None = None,
) -> dict[str, Any]:
    """Makes a run and gives its summary: frames, modes, `position_error_m`, `heading_error_rad`, times, ball.

    Of several robots the summary of each is in `robots`. A number without measurements is None.

    A path stands for the `Run` of that scenario with `seed`, `duration_s`, `preset`, `change` and `config`; None: as the
    `Run` has them by default. `record` writes a log, with its images as "png", "jpeg" or "none".
    `progress` gets the simulated seconds some ten times a second; an exception that it raises ends the run.
    Raises FileNotFoundError for a missing file, ValueError for an invalid value and TypeError for options beside a `Run`.
    """
    given = {"seed": seed, "duration_s": duration_s, "preset": preset, "change": change, "config": config}
    options: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if not isinstance(run, Run):
        run = Run(str(run), **options)
    elif options:
        raise TypeError(f"invalid options: {', '.join(options)} (expected none with a Run). Put them into the Run")
    if not run.files:
        return _simulate(run, Path(run.scenario), record, images, progress)
    with tempfile.TemporaryDirectory(prefix=FOLDER_PREFIX) as folder:
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


@dataclass(frozen=True)
class Step:
    """What a simulated robot measured from one image to the next."""

    samples: tuple[Sample, ...]
    """In order of time; the last one is the image, or the truth in a simulation without images."""
    ended: bool
    """The scenario's duration is over. The simulation can go on."""

    @property
    def truth(self) -> TruthSample:
        """The true state at the time of the image."""
        return next(sample for sample in reversed(self.samples) if isinstance(sample, TruthSample))

    @property
    def image(self) -> NDArray[np.uint8] | None:
        """The image as OpenCV has it (blue, green, red); None if the camera delivered none."""
        last = self.samples[-1]
        return last.image if isinstance(last, ImageSample) else None


class Simulation:
    """A running scenario: iterate over its samples, or drive its robot with `step`.

    `change`: values in place of the scenario's, by dotted key. `images=False` renders none: much faster, with truth at the
    camera's rate. Equal seeds and commands give equal samples.

    ValueError for an invalid scenario, and for one of several robots (`squad`), which `simulate` runs.

    Examples:
        >>> simulation = Simulation("config/scenarios/tracks_18x12.toml", seed=1)  # doctest: +SKIP
        >>> pipeline = simulation.pipeline()  # doctest: +SKIP
        >>> for sample in simulation:  # doctest: +SKIP
        ...     if cycle := pipeline.process(sample):
        ...         simulation.apply_camera_command(cycle)
        ...         print(cycle.pose)

    """

    def __init__(
        self,
        scenario: str | Path,
        *,
        seed: Whole | None = None,
        duration_s: Number | None = None,
        change: Mapping[str, Any] | None = None,
        images: bool = True,
    ) -> None:
        changes = dict(change) if isinstance(change, Mapping) else change
        self._core = _core.Simulation(scenario, seed=seed, duration_s=duration_s, change=changes, images=images)
        self._images = images

    @property
    def time_s(self) -> float:
        """Seconds since the start."""
        return self._core.time_s

    @property
    def duration_s(self) -> float:
        """Length of the scenario, seconds."""
        return self._core.duration_s

    def __iter__(self) -> Iterator[Sample]:
        """Samples until the end of the scenario."""
        while True:
            sample = sample_from_core(self._core.next_sample())
            if sample.stamp_s >= self.duration_s:
                return
            yield sample

    def step(self, velocity: Vector | None = None) -> Step:
        """Drives until the next image with a velocity: forward, left (m/s), turn (rad/s). None: along the scenario's path."""
        self._core.command(velocity)
        samples: list[Sample] = []
        while True:
            sample = sample_from_core(self._core.next_sample())
            samples.append(sample)
            if isinstance(sample, ImageSample) or (isinstance(sample, TruthSample) and not self._images):
                return Step(tuple(samples), ended=sample.stamp_s >= self.duration_s)

    def pipeline(self, *, preset: str = "default", config: Config | None = None) -> Pipeline:
        """The pipeline of the simulated robot, with the map of its calibration."""
        return Pipeline.of_simulation(self._core, preset=preset, config=config)

    def kidnap(self, pose: Vector) -> None:
        """Moves the robot to a pose (x, y in metres, θ in radians), at rest."""
        self._core.kidnap(pose)

    def push(self, impulse: Vector) -> None:
        """Pushes the robot: impulse along the field's x and y, N s."""
        self._core.push(impulse)

    def place_ball(
        self,
        position: Vector,
        *,
        velocity: Vector = (0.0, 0.0),
        height: Number = 0.0,
        vertical_velocity: Number = 0.0,
    ) -> None:
        """Places the ball on the field (metres) with a velocity (m/s), its lowest point at a height, without spin."""
        self._core.place_ball(position, velocity, height, vertical_velocity)

    def place_robot(self, index: Whole, pose: Vector) -> None:
        """Moves another robot to a pose, at rest; `index` as in `TruthSample.robots`."""
        self._core.place_robot(index, pose)

    def set_light(self, level: Number | None) -> None:
        """Light on the field in place of the scenario's (1: normal); None: the scenario's again."""
        self._core.set_light(level)

    def set_camera(self, *, exposure: Number, gain: Number) -> None:
        """Exposure and gain of the camera from the next image on."""
        self._core.set_camera(exposure, gain)

    def apply_camera_command(self, cycle: Cycle) -> None:
        """Sets the camera as the exposure control of a cycle asks, with the delay of a real camera."""
        if not isinstance(cycle, Cycle):
            raise TypeError(invalid("cycle", cycle, "a Cycle"))
        self._core.apply_camera_command(cycle.core)
