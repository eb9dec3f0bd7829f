"""Gymnasium environments on the simulator: learn to drive with what a robot sees, knows, or with the truth.

>>> from mirrorball.gym import DriveToBall  # doctest: +SKIP
>>> env = DriveToBall("config/scenarios/demo.toml", observe="estimate")  # doctest: +SKIP
>>> observation, info = env.reset(seed=1)  # doctest: +SKIP
>>> observation, reward, terminated, truncated, info = env.step([0.5, 0.0, 0.0])  # doctest: +SKIP

Needs `pip install mirrorball[gym]`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from mirrorball._core import Field
from mirrorball.arguments import Vector, checked, invalid
from mirrorball.estimates import Cycle
from mirrorball.pipeline import Config, Localizer
from mirrorball.simulation import Simulation, Step

__all__ = ["DriveToBall", "RobotEnv"]

Observation = NDArray[Any]

VELOCITY_MAX = 1000.0
"""Largest velocity that `Simulation.step` takes: m/s, rad/s."""


def __dir__() -> list[str]:
    return __all__


class RobotEnv(gymnasium.Env[Observation, NDArray[np.float32]], ABC):
    """A simulated robot under control; subclasses say what is rewarded and when an episode ends.

    Action: velocity as a share of `speed_max_mps` and `turn_max_radps`: forward, left, turn, each −1 to 1. One step lasts from
    image to image. Observation, by `observe`:

    - `truth`: x, y, cos θ, sin θ of the robot on the field, and the ball in the robot frame (metres; 0 without a ball).
    - `estimate`: the same as the robot's pipeline estimates it, and whether pose and ball are known (1 or 0).
    - `image`: the camera image, uint8, rows × columns × 3 (blue, green, red).

    `scenario`, `change` as in `Simulation`, `preset`, `config` as in `Pipeline`. Each episode is simulated with a seed drawn
    from the environment's generator, so `reset(seed=…)` repeats it. The seed draws the noise of the sensors and the play of
    other robots and people. The scenario says where the robot and the ball start, so without others all episodes with
    `observe="truth"` are equal. `change` varies them.

    ValueError for a speed below 0 or above 1000, and for an action that is not three finite numbers. Those beyond ±1 are
    limited.
    """

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 (the name and form are Gymnasium's)

    @checked
    def __init__(
        self,
        scenario: str | Path,
        *,
        observe: Literal["truth", "estimate", "image"] = "truth",
        duration_s: float = 20.0,
        speed_max_mps: float = 2.0,
        turn_max_radps: float = 3.0,
        change: Mapping[str, Any] | None = None,
        preset: str = "default",
        config: Config | None = None,
        render_mode: str | None = None,
    ) -> None:
        for name, value in (("speed_max_mps", speed_max_mps), ("turn_max_radps", turn_max_radps)):
            if not 0.0 <= value <= VELOCITY_MAX:
                raise ValueError(invalid(name, value, f"0 to {VELOCITY_MAX:g}"))
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise ValueError(invalid("render_mode", render_mode, " or ".join(["None", *map(repr, modes)])))
        if observe != "estimate":
            # Settings are checked even where no pipeline uses them.
            Localizer(field=Field(), preset=preset, config=config)
        self.observe = observe
        self.render_mode = render_mode
        self._scenario, self._change, self._duration_s = Path(scenario), dict(change or {}), duration_s
        self._preset, self._config = preset, config
        self._limits = np.array([speed_max_mps, speed_max_mps, turn_max_radps])
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
        # The observation space takes its shape from a first image.
        self._simulation, self._step = self._start(seed=0)
        self._has_begun = False
        self.observation_space = self._space()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Starts an episode; `options` are not used."""
        super().reset(seed=seed, options=options)
        self._simulation, self._step = self._start(seed=int(self.np_random.integers(2**31)))
        self._has_begun = True
        return self._observation(), self._info()

    def step(self, action: Vector) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drives until the next image; gymnasium.error.ResetNeeded before the first `reset`."""
        if not self._has_begun:
            raise gymnasium.error.ResetNeeded("no episode has begun (expected reset() before step())")
        before = self._step
        self._step = self._advance(self._limits * np.clip(_finite_action(action), -1.0, 1.0))
        terminated = self.has_ended(self._step)
        return self._observation(), self.reward(before, self._step), terminated, self._step.ended, self._info()

    @abstractmethod
    def reward(self, before: Step, after: Step) -> float:
        """What a step is worth."""

    @abstractmethod
    def has_ended(self, step: Step) -> bool:
        """The task is done, or failed."""

    def render(self) -> Any:
        """The camera image: rows × columns × (red, green, blue); None without images."""
        image = self._step.image
        return None if image is None else image[:, :, ::-1]

    def _start(self, *, seed: int) -> tuple[Simulation, Step]:
        images = self.observe != "truth" or self.render_mode is not None
        simulation = Simulation(self._scenario, seed=seed, duration_s=self._duration_s, change=self._change, images=images)
        self._pipeline = simulation.pipeline(preset=self._preset, config=self._config) if self.observe == "estimate" else None
        self._cycle: Cycle | None = None
        self._simulation = simulation
        return simulation, self._advance(np.zeros(3))

    def _advance(self, velocity: NDArray[np.float64]) -> Step:
        step = self._simulation.step(velocity)
        if self._pipeline is not None:
            for sample in step.samples:
                if cycle := self._pipeline.process(sample):
                    self._simulation.apply_camera_command(cycle)
                    self._cycle = cycle
        return step

    def _space(self) -> gymnasium.Space[Observation]:
        first = self._observation()
        if self.observe == "image":
            return gymnasium.spaces.Box(0, 255, first.shape, np.uint8)
        return gymnasium.spaces.Box(-np.inf, np.inf, first.shape, np.float32)

    def _observation(self) -> Observation:
        if self.observe == "image":
            assert self._step.image is not None, "images are rendered"
            return self._step.image
        numbers = self._true_numbers() if self.observe == "truth" else self._estimated_numbers()
        return np.array(numbers, dtype=np.float32)

    def _true_numbers(self) -> list[float]:
        truth = self._step.truth
        x, y, theta = truth.pose
        return [x, y, np.cos(theta), np.sin(theta), *ball_in_robot_frame(self._step)]

    def _estimated_numbers(self) -> list[float]:
        pose = self._cycle and self._cycle.pose
        ball = self._cycle and self._cycle.ball
        place = [pose.x_m, pose.y_m, np.cos(pose.theta_rad), np.sin(pose.theta_rad)] if pose else [0.0] * 4
        return [*place, *(ball.position_m if ball else (0.0, 0.0)), float(bool(pose)), float(bool(ball))]

    def _info(self) -> dict[str, Any]:
        truth = self._step.truth
        return {"stamp_s": truth.stamp_s, "pose": tuple(truth.pose), "ball": truth.ball}


class DriveToBall(RobotEnv):
    """Drive to the ball: the reward is the distance gained, in metres, and the episode ends at the ball."""

    reach_m = 0.4
    """Distance of the robot's centre from the ball at which it has arrived."""

    def reward(self, before: Step, after: Step) -> float:
        """Distance to the ball that was gained, metres."""
        return _ball_distance(before) - _ball_distance(after)

    def has_ended(self, step: Step) -> bool:
        """The ball is reached."""
        return _ball_distance(step) < self.reach_m


def _finite_action(action: Any) -> NDArray[np.float64]:
    try:
        numbers = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError):
        numbers = np.zeros(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        shown = action.tolist() if isinstance(action, np.ndarray) else action
        raise ValueError(invalid("action", shown, "3 finite numbers: forward, left, turn"))
    return numbers


def ball_in_robot_frame(step: Step) -> tuple[float, float]:
    """The true ball: forward and left, metres; the robot's own place if there is no ball."""
    truth = step.truth
    if truth.ball is None:
        return 0.0, 0.0
    dx, dy = truth.ball[0] - truth.pose.x_m, truth.ball[1] - truth.pose.y_m
    cos, sin = float(np.cos(truth.pose.theta_rad)), float(np.sin(truth.pose.theta_rad))
    return cos * dx + sin * dy, -sin * dx + cos * dy


def _ball_distance(step: Step) -> float:
    return float(np.hypot(*ball_in_robot_frame(step)))
