"""The panoramic mirror of nubot2013 (3.1, figure 2a): hyperbolic inside, then horizontally, then vertically isometric.

On an 18 × 12 m field: the middle as one viewpoint would show it, the floor to scale out to 8 m, and around it a
panorama in which a metre of height always has the same number of pixels.
"""

import argparse

from mirrorball.mirror import HorizontallyIsometric, Hyperboloid, VerticallyIsometric, design, plot_profile_and_image, view


def main(out: str) -> None:
    mirror = design(
        [
            Hyperboloid(eccentricity=1.25, until_ground_m=1.0),
            HorizontallyIsometric(until_t=0.36, until_m=8.0),
            VerticallyIsometric(until_t=0.42, until_height_m=1.2),
        ],
        pinhole_height_m=0.55,
        apex_above_pinhole_m=0.12,
        name="nubot2013",
    )
    image = view(mirror, pose=(-3.0, 1.0, 0.4), ball=(-1.5, 1.8), robots=[(-1.0, 0.0, 0.0), (2.0, 3.0, 1.0)])
    plot_profile_and_image(mirror, image).savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="nubot2013.png")
    main(parser.parse_args().out)
