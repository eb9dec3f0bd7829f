# %% design, Mirror, Part, HorizontallyIsometric, ConstantCurvature, Planar
from mirrorball.mirror import ConstantCurvature, HorizontallyIsometric, Mirror, Part, Planar, design

parts: list[Part] = [
    HorizontallyIsometric(until_t=0.22, until_m=6.0),
    ConstantCurvature(until_t=0.30, through_distance_m=11.2, through_height_m=0.6),
    Planar(seen_from_m=0.39, until_ground_m=0.51),
]
mirror: Mirror = design(parts, pinhole_height_m=0.6, apex_above_pinhole_m=0.2, name="mine")

# %% Sphere, Cone
from mirrorball.mirror import Cone, Sphere

old = design(
    [Sphere(radius_m=0.06, until_ground_m=1.5), Cone(until_ground_m=6.0)], pinhole_height_m=0.6, apex_above_pinhole_m=0.1
)

# %% Hyperboloid, VerticallyIsometric
from mirrorball.mirror import Hyperboloid, VerticallyIsometric

three_parts = design(
    [
        Hyperboloid(eccentricity=1.25, until_ground_m=1.0),
        HorizontallyIsometric(until_t=0.36, until_m=8.0),
        VerticallyIsometric(until_t=0.42, until_height_m=1.2),
    ],
    pinhole_height_m=0.55,
    apex_above_pinhole_m=0.12,
)

# %% Paraboloid
from mirrorball.mirror import Paraboloid

parabola = design([Paraboloid(focal_length_m=0.03, until_t=0.2)], pinhole_height_m=0.6, apex_above_pinhole_m=0.15)

# %% Free
import numpy as np

from mirrorball.mirror import Free


def target(t):
    """Ground distance and height that the ray of slope t shows."""
    return 1.5 * np.sinh(6.0 * t), np.zeros_like(t)


smooth = design([Free(target=target, until_t=0.38, tangent_continuous=True)], pinhole_height_m=0.55, apex_above_pinhole_m=0.16)

# %% REFERENCE_DESIGNS, lima2001, nubot2013, minho_like, sphere_cone_1999
from mirrorball.mirror import REFERENCE_DESIGNS, lima2001, minho_like, nubot2013, sphere_cone_1999

for ready in (lima2001(), nubot2013(), minho_like(), sphere_cone_1999()):
    print(ready.name in REFERENCE_DESIGNS, ready.radius_m)

# %% load, DesignSpec
from mirrorball.mirror import DesignSpec, load

plan: DesignSpec = load("config/mirrors/lima2001.toml")

# %% optimise, OptimisationResult, Requirement, Resolution, Heights, MaxDiameter, MinCurvatureRadius
from mirrorball.mirror import Heights, MaxDiameter, MinCurvatureRadius, OptimisationResult, Requirement, Resolution, optimise

wanted: list[Requirement] = [
    Resolution(from_m=0.5, to_m=6.0, px_per_m=12.0),
    Heights(at_m=7.0, to_height_m=0.8, px=10.0),
    MaxDiameter(diameter_m=0.2),
    MinCurvatureRadius(radius_m=0.005),
]
best: OptimisationResult = optimise(wanted, camera=plan.camera, apex_above_pinhole_m=0.17, progress=False)
print(best.share, best.conflicts)

# %% fit_camera
from mirrorball.mirror import fit_camera

camera = fit_camera(mirror, size_px=480)

# %% judge, OpticalAnalysis, View, ObjectSizes, Lens
from mirrorball.mirror import Lens, ObjectSizes, OpticalAnalysis, View, judge

judged: OpticalAnalysis = judge(mirror, focal_px=camera.focal_px, lens=Lens(focal_length_m=0.006, f_number=2.0))
first: View = judged.views[0]
sizes: ObjectSizes = judged.sizes
print(judged.blind_m, first.ground_m[-1], sizes.ball_radial_px.max())

# %% visible_heights, VisibleHeights
from mirrorball.mirror import VisibleHeights, visible_heights

seen: tuple[VisibleHeights, ...] = visible_heights(judged)
print([part.shows(distance_m=5.0, height_m=0.2) for part in seen])

# %% compare_with_papers, PaperFigure
from mirrorball.mirror import PaperFigure, compare_with_papers

figures: list[PaperFigure] = compare_with_papers(judged)
print(figures[0].quantity, figures[0].paper, figures[0].design)

# %% ground_costs, GroundCost
from mirrorball.mirror import GroundCost, ground_costs

costs: list[GroundCost] = ground_costs(mirror, camera=camera)
print({cost.imperfection: float(cost.rms_m[7]) for cost in costs})

# %% monte_carlo, Tolerances, GroundErrors
from mirrorball.mirror import GroundErrors, Tolerances, monte_carlo

errors: GroundErrors = monte_carlo(mirror, camera=camera, tolerances=Tolerances(tilt_deg=0.1), count=10, progress=False)
print(errors.total_95_m)

# %% Rays, reflect, slope_to_point
from mirrorball.mirror import Rays, reflect, slope_to_point

t, y_m = np.array([0.1]), np.array([0.2])
slope = slope_to_point(t=t, y_m=y_m, distance_m=np.array([3.0]), height_m=np.array([0.0]), pinhole_height_m=0.6)
rays: Rays = reflect(t=t, y_m=y_m, slope=slope, pinhole_height_m=0.6)
print(rays.distance_at_m(0.0))

# %% Segment
from mirrorball.mirror import Segment

inner: Segment = mirror.segments[0]
print(inner.part, inner.t_to, inner.end())

# %% view, plot_profile_and_image
from mirrorball.mirror import plot_profile_and_image, view

image = view(mirror, pose=(-1.0, 0.0, 0.0), camera=camera, ball=(1.0, 0.0))
plot_profile_and_image(mirror, image).savefig("mirror.png")

# %% preview, Preview, plot_preview
from mirrorball.mirror import Preview, plot_preview, preview

hall: Preview = preview(plan.mirror, scenario="config/scenarios/demo.toml", camera=plan.camera)
plot_preview(hall).savefig("hall.png")

# %% report, Report
from mirrorball.mirror import Report, report

written: Report = report(mirror, folder="report", camera=camera, progress=False)

# %% drawing, radius_table, write_pdf
from mirrorball.mirror import drawing, radius_table, write_pdf

drawing(mirror, camera=camera).savefig("drawing.svg")
write_pdf(mirror, "drawing.pdf", camera=camera)
print(radius_table(mirror)[:3])

# %% write_csv, write_dxf, write_stl, Export
from mirrorball.mirror import Export, write_csv, write_dxf, write_stl

profile: Export = write_csv(mirror, "mirror.csv")
print(profile.deviation_m, write_dxf(mirror, "mirror.dxf").deviation_m, write_stl(mirror, "mirror.stl").deviation_m)

# %% read_dxf, read_stl
from mirrorball.mirror import read_dxf, read_stl

outlines, triangles = read_dxf("mirror.dxf"), read_stl("mirror.stl")

# %% write_step
from mirrorball.mirror import write_step

write_step(mirror, "mirror.step")  # needs mirrorball[step]
