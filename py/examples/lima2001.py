"""The multi-part mirror of lima2001: isometric to 6 m, curved for what is far and high, flat for what is near.

Its figures 5 and 6: the profile, and a robot near the middle of the small field of 2001. Straight lines stay straight
inside, since the floor is shown to scale; the outer ring shows the floor around the robot once more, much larger.
"""

import argparse

from mirrorball.mirror import ConstantCurvature, HorizontallyIsometric, Planar, design, plot_profile_and_image, view


def main(out: str) -> None:
    mirror = design(
        [
            HorizontallyIsometric(until_t=0.22, until_m=6.0),
            ConstantCurvature(until_t=0.30, through_distance_m=11.2, through_height_m=0.6),
            Planar(seen_from_m=0.39, until_ground_m=0.51),
        ],
        pinhole_height_m=0.60,
        apex_above_pinhole_m=0.20,
        name="lima2001",
    )
    image = view(mirror, pose=(-1.5, 0.5, 0.3), ball=(-1.08, 0.62), robots=[(1.0, 1.2, 0.0), (-3.5, -2.0, 1.0)])
    plot_profile_and_image(mirror, image).savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="lima2001.png")
    main(parser.parse_args().out)
