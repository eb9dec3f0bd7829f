"""Gymnasium's own check of the environments, and what their numbers mean."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from mirrorball.gym import VELOCITY_MAX, DriveToBall

SCENARIO = Path(__file__).parents[1] / "config/scenarios/demo.toml"


# The world has no bounds that a space could state, and the check warns of that.
@pytest.mark.filterwarnings("ignore:.*A Box observation space m(in|ax)imum value is.*:UserWarning")
@pytest.mark.filterwarnings("ignore:.*render method.*:UserWarning")
@pytest.mark.filterwarnings("ignore:.*no render fps.*:UserWarning")
@pytest.mark.parametrize("observe", ["truth", "estimate", "image"])
def test_environment_passes_gymnasiums_check(observe: Literal["truth", "estimate", "image"]) -> None:
    check_env(DriveToBall(SCENARIO, observe=observe, duration_s=2.0), skip_render_check=True)


def test_robot_that_drives_towards_the_ball_arrives_and_gains_its_distance() -> None:
    env = DriveToBall(SCENARIO, change={"others.opponents": 0, "others.mates": 0})
    observation, _ = env.reset(seed=3)
    start = float(np.hypot(*observation[4:6]))
    gained, terminated, truncated = 0.0, False, False
    while not (terminated or truncated):
        forward, left = observation[4:6]
        toward = np.array([forward, left]) / np.hypot(forward, left)
        observation, reward, terminated, truncated, info = env.step(np.array([*toward, 0.0], dtype=np.float32))
        gained += reward
    assert terminated
    assert start - gained < DriveToBall.reach_m
    assert info["ball"] is not None


def test_estimate_agrees_with_truth_once_the_robot_knows_its_place() -> None:
    env = DriveToBall(SCENARIO, observe="estimate")
    observation, info = env.reset(seed=2)
    for _ in range(40):
        observation, _, _, _, info = env.step(np.array([0.3, 0.0, 0.1], dtype=np.float32))
    assert observation[6] == 1.0
    x, y, theta = info["pose"]
    # Up to the half turn that a symmetric field allows.
    side = 1.0 if np.hypot(observation[0] - x, observation[1] - y) < 1.0 else -1.0
    assert observation[:4] == pytest.approx(np.array([x, y, np.cos(theta), np.sin(theta)]) * side, abs=0.1)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"render_mode": "human"}, r"invalid render_mode: 'human' \(expected None or 'rgb_array'\)"),
        ({"preset": "nope"}, "unknown preset"),
        ({"speed_max_mps": -1.0}, r"invalid speed_max_mps: -1\.0"),
        ({"turn_max_radps": -1.0}, r"invalid turn_max_radps: -1\.0"),
        ({"speed_max_mps": 1e6}, r"invalid speed_max_mps: 1000000\.0 \(expected 0 to 1000\)"),
        ({"turn_max_radps": 1e6}, r"invalid turn_max_radps: 1000000\.0"),
    ],
)
def test_invalid_options_of_an_environment_are_rejected(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DriveToBall(SCENARIO, **wrong)


def test_step_needs_a_reset_and_three_finite_numbers() -> None:
    env = DriveToBall(SCENARIO, duration_s=1.0)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(3, dtype=np.float32))
    env.reset(seed=1)
    wrong: list[Any] = [np.full(3, np.inf), np.full(3, np.nan), np.zeros(2), np.zeros((1, 3)), None, "forward"]
    for action in wrong:
        with pytest.raises(ValueError, match=r"invalid action: .* \(expected 3 finite numbers"):
            env.step(action)


def test_seed_draws_noise_and_other_robots_alone() -> None:
    def poses_and_balls(seed: int, change: dict[str, Any]) -> Any:
        env = DriveToBall(SCENARIO, duration_s=4.0, change=change)
        seen = [env.reset(seed=seed)[0]]
        seen += [env.step(np.array([0.5, 0.2, 0.1], dtype=np.float32))[0] for _ in range(100)]
        return np.array(seen)

    alone = {"others.opponents": 0, "others.mates": 0}
    assert np.array_equal(poses_and_balls(1, alone), poses_and_balls(2, alone))
    assert not np.array_equal(poses_and_balls(1, {}), poses_and_balls(2, {}))


def test_largest_velocity_of_an_environment_can_be_driven() -> None:
    env = DriveToBall(SCENARIO, speed_max_mps=VELOCITY_MAX, turn_max_radps=VELOCITY_MAX)
    env.reset(seed=1)
    env.step(np.array([1.0, -1.0, 1.0], dtype=np.float32))
