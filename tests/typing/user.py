"""A user's script: strict type checks pass (`make types`, `tests/test_package.py`). It is not run."""

import cv2
import numpy as np

import mirrorball
from mirrorball.gym import DriveToBall
from mirrorball.sweep import grid
from mirrorball.vision import Vision, see

image = cv2.imread("image.png")
assert image is not None
found = see(image, map="map.npz")
for detections in (found, Vision(map=mirrorball.GroundMap.load("map.npz")).process(image)):
    print(detections.ball["x_m"], detections.carpet_share)
cycle = mirrorball.Pipeline("robot.toml").image(0.0, image)
if cycle.pose is not None:
    print(cycle.pose.x_m, cycle.covariance[0, 0], cycle.timings_ms["vision"])
estimate = mirrorball.Localizer(field="field.toml").points(0.0, [[1.0, 2.0]])
camera = mirrorball.Camera(width_px=480, height_px=480, focal_px=500.0, pinhole_height_m=0.6)
profile = mirrorball.Profile(radius_m=[0.0, 0.01, 0.02, 0.03, 0.04], height_m=[0.8, 0.81, 0.82, 0.83, 0.84])
ground = mirrorball.ground_map(camera=camera, profile=profile)
print(estimate.mode, camera.centre_px, ground.x_m.shape)
for step in range(10):
    truth = mirrorball.Simulation("demo.toml", seed=step).step((1.0, 0.0, 0.5)).truth
    print(truth.pose.theta_rad)
# Numbers and arrays may be numpy's.
camera = mirrorball.Camera(
    width_px=480, height_px=np.int64(480), focal_px=np.float32(500.0), pinhole_height_m=1, centre_px=np.array([240, 240])
)
mount = mirrorball.Mount(lean_deg=np.array([1, 0]), mirror_raise_m=np.float32(0.001))
localizer = mirrorball.Localizer(field="field.toml")
localizer.odometry(np.float32(0.0), np.array([1, 2, 3]))
localizer.set_pose(0, [np.float32(0.0), 1, 0.3])
simulation = mirrorball.Simulation("demo.toml", seed=np.int64(3), duration_s=np.float32(2.0))
simulation.place_robot(np.int64(0), simulation.step(np.zeros(3)).truth.pose)
environment = DriveToBall("demo.toml")
for action in ([0.5, 0.0, 0.0], np.zeros(3), np.zeros(3, dtype=np.float32)):
    environment.step(action)
runs = grid("demo.toml", seeds=range(3), change={"path.speed": np.arange(3), "wheels.noise": [0.1]})
summary = mirrorball.simulate("demo.toml", seed=np.int64(1), preset="nubot2013", record="game.mcap", images="none")
print(mount, runs, summary, mirrorball.simulate(runs[0]))
