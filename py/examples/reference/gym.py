# %% DriveToBall
import numpy as np

from mirrorball.gym import DriveToBall

env = DriveToBall("config/scenarios/demo.toml", observe="truth", duration_s=2.0)
observation, info = env.reset(seed=1)
observation, reward, terminated, truncated, info = env.step(np.array([1.0, 0.0, 0.2], dtype=np.float32))

# %% RobotEnv
from mirrorball.gym import RobotEnv
from mirrorball.simulation import Step


class StayInTheCentre(RobotEnv):
    """Rewards an agent for each metre towards the centre."""

    def reward(self, before: Step, after: Step) -> float:
        return float(np.hypot(*before.truth.pose[:2]) - np.hypot(*after.truth.pose[:2]))

    def has_ended(self, step: Step) -> bool:
        return False


StayInTheCentre("config/scenarios/demo.toml").reset(seed=1)
