"""A smooth one-part mirror like that of minho2016 (III.A, figure 1), from a free part: any function of t will do.

Near the robot the floor is shown evenly, further off a metre shrinks in proportion to its distance, as far as 9 m.
"""

import argparse

import numpy as np
from numpy.typing import NDArray

from mirrorball.mirror import Free, design, plot_profile_and_image, view

T_RIM = 0.38
LINEAR_TO_M, REACH_M = 1.5, 9.0


def wanted(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Distance and height that the camera ray of slope t should see."""
    steepness = np.arcsinh(REACH_M / LINEAR_TO_M)
    return LINEAR_TO_M * np.sinh(steepness * t / T_RIM), np.zeros_like(t)


def main(out: str) -> None:
    mirror = design(
        [Free(target=wanted, until_t=T_RIM, tangent_continuous=True, name="even near, logarithmic far")],
        pinhole_height_m=0.55,
        apex_above_pinhole_m=0.16,
        name="like minho2016",
    )
    image = view(mirror, pose=(-3.0, 1.0, 0.4), ball=(-1.5, 1.8), robots=[(-1.0, 0.0, 0.0), (2.0, 3.0, 1.0)])
    plot_profile_and_image(mirror, image).savefig(out)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="minho_like.png")
    main(parser.parse_args().out)
