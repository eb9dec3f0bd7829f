"""Published mirrors, as starting points and for comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from mirrorball.arguments import checked
from mirrorball.mirror.parts import (
    Cone,
    ConstantCurvature,
    Free,
    HorizontallyIsometric,
    Hyperboloid,
    Planar,
    Sphere,
    VerticallyIsometric,
)
from mirrorball.mirror.profile_design import Mirror, design
from mirrorball.mirror.reflection import Array


def lima2001() -> Mirror:
    """The multi-part mirror of lima2001 2.2 to 2.5: isometric to 6 m, curved to (11.2 m, 0.6 m), flat for 0.39 to 0.51 m.

    Heights and slopes: docs/methods.md 2.3. The plane begins where the curved part ends and shows 0.33 m there; the ring
    up to 0.39 m would show the robot's own hull and is left black.
    """
    return design(
        [
            HorizontallyIsometric(until_t=0.22, until_m=6.0),
            ConstantCurvature(until_t=0.30, through_distance_m=11.2, through_height_m=0.6),
            Planar(seen_from_m=0.39, until_ground_m=0.51),
        ],
        pinhole_height_m=0.60,
        apex_above_pinhole_m=0.20,
        name="lima2001",
    )


def sphere_cone_1999() -> Mirror:
    """The mirror of 1999 (lima2001 2.1): a spherical apex to 1.5 m, a tangent cone to 6 m, 18.5 cm in diameter.

    The paper gives no distance to the camera: 0.10 m lets a lens of ± 32° fill the image. The sphere's radius is then the
    only one that gives the diameter.
    """

    def parts(radius_m: float) -> Mirror:
        return design(
            [Sphere(radius_m=radius_m, until_ground_m=1.5), Cone(until_ground_m=6.0)],
            pinhole_height_m=0.60,
            apex_above_pinhole_m=0.10,
            name="sphere_cone_1999",
        )

    radius = scipy.optimize.brentq(lambda radius_m: 2.0 * parts(radius_m).radius_m - 0.185, 0.03, 0.08, xtol=1e-14)
    return parts(float(radius))


def nubot2013() -> Mirror:
    """nubot2013 3.1: hyperbolic to 1 m, horizontally isometric to 8 m, then vertically isometric to 1.2 m at 8 m.

    The paper gives the order of the parts; the distances are chosen for an 18 × 12 m field.
    """
    return design(
        [
            Hyperboloid(eccentricity=1.25, until_ground_m=1.0),
            HorizontallyIsometric(until_t=0.36, until_m=8.0),
            VerticallyIsometric(until_t=0.42, until_height_m=1.2),
        ],
        pinhole_height_m=0.55,
        apex_above_pinhole_m=0.12,
        name="nubot2013",
    )


@dataclass(frozen=True)
class _SinhTarget:
    even_to_m: float
    steepness: float

    def __call__(self, t: Array) -> tuple[Array, Array]:
        return self.even_to_m * np.sinh(self.steepness * t), np.zeros_like(t)


@checked
def minho_like(*, reach_m: float = 9.0, even_to_m: float = 1.5) -> Mirror:
    """One smooth part like that of minho2016 III.A, whose design is not published: d = a·sinh(t/b).

    Near the robot the ground is shown evenly, from `even_to_m` on a metre shrinks in proportion to its distance, and the
    rim shows `reach_m`.
    """
    t_rim = 0.38
    if not (reach_m > 0.0 and even_to_m > 0.0):
        raise ValueError(f"reach_m = {reach_m}, even_to_m = {even_to_m}: both must be positive")
    target = _SinhTarget(even_to_m, steepness=float(np.arcsinh(reach_m / even_to_m)) / t_rim)
    return design(
        [Free(target=target, until_t=t_rim, tangent_continuous=True, name="even near, logarithmic far")],
        pinhole_height_m=0.55,
        apex_above_pinhole_m=0.16,
        name="minho_like",
    )


REFERENCE_DESIGNS: dict[str, Callable[[], Mirror]] = {
    "lima2001": lima2001,
    "sphere_cone_1999": sphere_cone_1999,
    "nubot2013": nubot2013,
    "minho_like": minho_like,
}
"""By name, as `mirrorball mirror` takes them."""
