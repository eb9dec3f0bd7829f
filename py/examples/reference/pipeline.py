# %% Pipeline
import cv2

from mirrorball.pipeline import Pipeline

robot = Pipeline("samples/sequence", config={"localize.matching.steps_max": 20})
robot.odometry(0.0, [0.0, 0.0, 0.0])
cycle = robot.image(0.0, cv2.imread("samples/sequence/frames/000.jpg"))
print(cycle.mode, cycle.pose, cycle.covariance)

# %% Localizer
import numpy as np

from mirrorball.pipeline import Localizer

localizer = Localizer(field="samples/sequence/field.toml")
localizer.odometry(0.02, [0.01, 0.0, 0.002])
estimate = localizer.points(0.03, np.array([[1.0, 0.5], [2.0, 0.4]]), std_m=0.02)
