# %% Profile
from mirrorball import Profile

profile = Profile.load("samples/sequence/mirror.csv")
height_m, slope = profile.height_and_slope(profile.radius_m[:3])

# %% Camera
from mirrorball import Camera

camera = Camera.load("samples/sequence/robot.toml")
print(camera.width_px, camera.focal_px)

# %% Mount
from mirrorball import Mount

tilted = Mount(mirror_tilt_deg=(0.5, 0.0), mirror_offset_m=(0.001, 0.0))

# %% Field
from mirrorball import Field

field = Field("samples/sequence/field.toml")
print(field.length_m, field.width_m)

# %% ground_map
from mirrorball import ground_map

upright = ground_map(camera=camera, profile=profile)
crooked = ground_map(camera=camera, profile=profile, mount=tilted)

# %% GroundMap
from mirrorball import GroundMap

crooked.save("map.npz")
print(GroundMap.load("map.npz") == crooked, upright.x_m.shape)

# %% trace_rays
from mirrorball import trace_rays

origin_m, direction = trace_rays(camera=camera, profile=profile)

# %% trace_points
import numpy as np

from mirrorball import trace_points

origin_m, direction = trace_points(camera=camera, profile=profile, u_px=np.array([300.0]), v_px=np.array([240.0]))

# %% render
from mirrorball import render

image = render(camera=camera, profile=profile, field=field, pose=(0.0, 0.0, 0.3), ball=(1.0, 0.5))

# %% ColourTable
from mirrorball import ColourTable
from mirrorball.vision import learn_colours

table, _ = learn_colours(map=upright, images=[image], camera=camera)
table.save("colours.npz")
classes = ColourTable.load("colours.npz").classify(image)

# %% Pipeline, Cycle
from mirrorball import Cycle, Pipeline

robot = Pipeline("samples/sequence", map="map.npz")
cycle: Cycle = robot.image(0.0, image)
print(cycle.mode, cycle.pose, cycle.timings_ms)

# %% Localizer, Estimate, Pose
from mirrorball import Estimate, Localizer, Pose

localizer = Localizer(field=field)
localizer.set_pose(0.0, Pose(0.0, 0.0, 0.3))
estimate: Estimate = localizer.points(0.0, np.array([[1.0, 0.5], [2.0, 0.4]]))
print(estimate.mode, np.sqrt(np.diag(estimate.covariance)))

# %% Run, simulate
from mirrorball import Run, simulate

run = Run("config/scenarios/demo.toml", seed=3, duration_s=0.5, change={"path.speed": 1.0})
summary = simulate(run, record="game.mcap")

# %% Log
from mirrorball import Log

log = Log("game.mcap")
print(log.topics, log.columns("/odometry")["dx"][:3])

# %% Simulation
from mirrorball import Simulation

simulation = Simulation("config/scenarios/demo.toml", seed=1)
step = simulation.step([1.0, 0.0, 0.5])
print(step.truth.pose)
