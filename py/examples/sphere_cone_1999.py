"""The mirror of 1999 (lima2001 2.1, figure 2b): a spherical apex to 1.5 m, a tangent cone to 6 m, 18.5 cm wide.

What is beyond 1.5 m is drawn out by the cone: the outer part of the image is distorted, and a straight line bends where
the two parts meet. The radius of the sphere follows from the diameter.
"""

import argparse

from scipy.optimize import brentq

from mirrorball.mirror import Cone, Mirror, Sphere, design, plot_profile_and_image, view


def built(radius_m: float) -> Mirror:
    return design(
        [Sphere(radius_m=radius_m, until_ground_m=1.5), Cone(until_ground_m=6.0)],
        pinhole_height_m=0.60,
        apex_above_pinhole_m=0.10,
        name="sphere and cone, 1999",
    )


def main(out: str) -> None:
    mirror = built(brentq(lambda radius_m: 2.0 * built(radius_m).radius_m - 0.185, 0.03, 0.08))
    image = view(mirror, pose=(-1.5, 0.5, 0.3), ball=(-0.4, 1.2), robots=[(1.0, 1.2, 0.0), (-3.5, -2.0, 1.0)])
    plot_profile_and_image(mirror, image).savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="sphere_cone_1999.png")
    main(parser.parse_args().out)
