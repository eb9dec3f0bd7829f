# %% see, Detections
import cv2

from mirrorball import Camera, Field, Profile, ground_map
from mirrorball.vision import Detections, see

camera = Camera.load("samples/sequence/robot.toml")
upright = ground_map(camera=camera, profile=Profile.load("samples/sequence/mirror.csv"))
images = [cv2.imread(f"samples/sequence/frames/{number:03}.jpg") for number in range(0, 20, 2)]
found: Detections = see(images[0], map=upright, camera=camera)
print(found.points["x_m"][:3], found.ball)

# %% Vision
from mirrorball.vision import Vision

vision = Vision(map=upright, camera=camera)
counts = [len(vision.process(image).points) for image in images]

# %% detections_from_columns
from mirrorball import _core
from mirrorball.vision import detections_from_columns

same = detections_from_columns(_core.Vision(line_width_m=0.125, map=upright, camera=camera).process(images[0]))

# %% calibrate_lines, Residual
from mirrorball.vision import Residual, calibrate_lines

field = Field("samples/sequence/field.toml")
calibrated, rms_m, share, residuals = calibrate_lines(camera=camera, start=upright, field=field, images=images)
worst: Residual = max(residuals, key=lambda residual: residual.rms_px)

# %% calibrate_strip
import csv
from pathlib import Path

from mirrorball.vision import calibrate_strip

folder = Path("samples/calibration")
with (folder / "strip.csv").open() as file:
    rows = list(csv.DictReader(file))
by_strip = calibrate_strip(
    camera=Camera.load(folder / "robot.toml"),
    images=[cv2.imread(str(folder / row["file"])) for row in rows],
    directions_rad=[float(row["direction_rad"]) for row in rows],
    first_edge_m=0.4,
    spacing_m=0.25,
    bars=23,
    width_m=0.3,
)

# %% calibrate_mask
from mirrorball.vision import calibrate_mask

mask = calibrate_mask(camera=camera, images=images)

# %% calibrate_sizes
from mirrorball.vision import calibrate_sizes

sizes = calibrate_sizes(map=upright, images=images, camera=camera)

# %% learn_colours, ColourTable
from mirrorball.vision import ColourTable, learn_colours

table, _ = learn_colours(map=upright, images=images[:3], camera=camera)
assert isinstance(table, ColourTable)

# %% colours_from_labels
from mirrorball.vision import colours_from_labels

cv2.imwrite("image.png", images[0])
labels = [f"image.png,{u},{200 + u % 7},carpet" for u in range(300, 340)]
Path("labels.csv").write_text("\n".join(["file,u,v,class", *labels]) + "\n")
painted = colours_from_labels("labels.csv")
