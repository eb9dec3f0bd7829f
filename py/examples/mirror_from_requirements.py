"""Mirrors from requirements: feasible ones, conflicting ones, and the best mirror for both."""

import argparse

from mirrorball import Camera
from mirrorball.mirror import (
    Heights,
    MaxDiameter,
    MinCurvatureRadius,
    Requirement,
    Resolution,
    optimise,
    plot_profile_and_image,
    view,
)


def main(out: str) -> None:
    camera = Camera(width_px=480, height_px=480, focal_px=580.0, pinhole_height_m=0.6, outer_radius_px=234.0)
    wishes: list[Requirement] = [
        Resolution(from_m=0.5, to_m=2.0, px_per_m=40.0),
        Resolution(from_m=2.0, to_m=8.0, px_per_m=10.0),
        Heights(at_m=9.0, to_height_m=0.8, px=20.0),
    ]
    found = optimise(wishes, camera=camera, apex_above_pinhole_m=0.17, name="from wishes")
    for wish, met in found.met:
        print(f"{wish}: met to {100.0 * met:.0f} %")
    tighter: list[Requirement] = [*wishes, MaxDiameter(diameter_m=0.1), MinCurvatureRadius(radius_m=0.01)]
    small = optimise(tighter, camera=camera, apex_above_pinhole_m=0.17)
    print(f"a smaller one meets everything only to {100.0 * small.share:.0f} %; in conflict:")
    for wish in small.conflicts:
        print(f"  {wish}")
    image = view(found.mirror, camera=camera, pose=(-3.0, 1.0, 0.4), ball=(-1.5, 1.8), robots=[(-1.0, 0.0, 0.0)])
    plot_profile_and_image(found.mirror, image).savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="wishes.png")
    main(parser.parse_args().out)
