"""A user's mistakes: a type check finds each one, or calls its comment unused. It is not run."""

import numpy as np

import mirrorball
from mirrorball.gym import DriveToBall
from mirrorball.sweep import grid

mirrorball.Camera(width_px="480", height_px=480)  # type: ignore[arg-type]
mirrorball.Camera(width_px=480, height_px=480.5)  # type: ignore[arg-type]
mirrorball.Camera(width_px=480, height_px=480, focal_px=np.zeros(2))  # type: ignore[arg-type]
mirrorball.Mount(lean_deg=3.0)  # type: ignore[arg-type]
mirrorball.Simulation("demo.toml", seed=1.5)  # type: ignore[arg-type]
mirrorball.Simulation("demo.toml").step("abc")  # type: ignore[arg-type]
DriveToBall("demo.toml").step("abc")  # type: ignore[arg-type]
mirrorball.simulate("demo.toml", sed=3)  # type: ignore[call-arg]
mirrorball.simulate("demo.toml", images="bmp")  # type: ignore[arg-type]
mirrorball.simulate("demo.toml", preset=3)  # type: ignore[arg-type]
grid("demo.toml", seeds="12")  # type: ignore[arg-type]
grid("demo.toml", change={"path.speed": 2.0})  # type: ignore[dict-item]
