"""Numerical integration of the design equation: the profile that reflects each camera ray to its target point.

With t = X/Y as the variable, d(ln Y)/dt = Y′/(1 − t·Y′), where Y′ is what the law of reflection asks for at (t, Y). The
denominator is the cosine of incidence but for a positive factor: where it reaches zero the ray only grazes the mirror, and a
profile beyond would fold back on itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from mirrorball.mirror.reflection import Array, slope_to_point
from mirrorball.mirror.segment import Segment, Start

Target = Callable[[Array], tuple[Array, Array]]
"""Slopes t to (distance from the axis, height above the ground), metres."""

MIN_FACING = 1e-3
"""Where 1 − t·Y′ falls below this the ray grazes the mirror (some 0.05° of incidence left)."""

MIN_TARGET_DISTANCE_M = 0.01
"""A wanted point this close to the mirror's own surface is one that the growing profile runs into."""

RTOL, ATOL = 1e-12, 1e-14
"""Of ln Y: 0.2 pm on a mirror 0.2 m away, so that a metre on the ground is wrong by less than a nanometre."""


def integrate(target: Target, start: Start, *, until_t: float, part: str, tangent_continuous: bool) -> Segment:
    """Solves the design equation from `start` to `until_t`; ValueError if a ray cannot be met on the way."""
    if not start.t < until_t:
        raise start.refuse(part, f"ends at t = {until_t:.4f}, where it should begin or earlier", start.t)
    if until_t > start.t_max:
        raise start.refuse(part, f"the lens sees no further than t = {start.t_max:.4f}", until_t)

    def tangent(t: Array, y: Array) -> Array:
        return _tangent(target, start.pinhole_height_m, t, y)

    def facing(t: float, state: Array) -> float:
        return 1.0 - t * float(tangent(np.array([t]), np.exp(np.minimum(state, 20.0)))[0]) - MIN_FACING

    def rate(t: float, state: Array) -> Array:
        slope = tangent(np.array([t]), np.exp(np.minimum(state, 20.0)))
        return slope / np.maximum(1.0 - t * slope, MIN_FACING)

    def apart(t: float, state: Array) -> float:
        distance, height = (float(np.ravel(np.asarray(a))[0]) for a in target(np.array([t])))
        y = float(np.exp(state[0]))
        return float(np.hypot(distance - t * y, y + start.pinhole_height_m - height)) - MIN_TARGET_DISTANCE_M

    apart.terminal = True  # type: ignore[attr-defined]
    facing.terminal = True  # type: ignore[attr-defined]
    _validate_target(target, start, until_t=until_t, part=part)
    if min(facing(start.t, np.log([start.y_m])), apart(start.t, np.log([start.y_m]))) <= 0.0:
        raise start.refuse(part, "the wanted point lies behind the mirror: no tangent sends the ray there", start.t)
    solution = scipy.integrate.solve_ivp(
        rate,
        (start.t, until_t),
        np.log([start.y_m]),
        method="DOP853",
        rtol=RTOL,
        atol=ATOL,
        dense_output=True,
        events=(facing, apart),
    )
    if solution.status == 1 and solution.t_events[1].size:
        raise start.refuse(
            part,
            "the profile runs into the wanted point itself: it lies above the mirror, inside the camera's own ray",
            float(solution.t_events[1][0]),
        )
    if solution.status == 1:
        raise start.refuse(
            part,
            "the ray would have to graze the mirror to meet its wanted point; beyond, the profile would fold back",
            float(solution.t_events[0][0]),
        )
    if not solution.success:
        why = "the tangent would have to change without bound to follow the wanted points"
        raise start.refuse(part, why, float(solution.t[-1]))
    curve = _Integrated(target, start.pinhole_height_m, solution.sol)
    _require_target_below_mirror(target, curve.height, start, until_t=until_t, part=part)
    return Segment(
        part=part,
        number=start.number,
        t_from=start.t,
        t_to=until_t,
        height=curve.height,
        tangent=curve.tangent,
        tangent_continuous=tangent_continuous,
    )


@dataclass(frozen=True)
class _Integrated:
    """The solution of the design equation: ln Y over t. A class, so that a mirror can be pickled."""

    target: Target
    pinhole_height_m: float
    log_height: Callable[[Array], Array]

    def height(self, t: Array) -> Array:
        return np.asarray(np.exp(self.log_height(np.atleast_1d(t))[0]))

    def tangent(self, t: Array, y: Array) -> Array:
        return _tangent(self.target, self.pinhole_height_m, t, y)


def _tangent(target: Target, pinhole_height_m: float, t: Array, y: Array) -> Array:
    """The tangent that sends the ray at (t, Y) to its target."""
    distance, height = (np.broadcast_to(np.asarray(a, dtype=np.float64), t.shape) for a in target(t))
    return slope_to_point(t=t, y_m=y, distance_m=distance, height_m=height, pinhole_height_m=pinhole_height_m)


def _validate_target(target: Target, start: Start, *, until_t: float, part: str) -> None:
    t = np.linspace(start.t, until_t, 257)
    distance, height = (np.broadcast_to(np.asarray(a, dtype=np.float64), t.shape) for a in target(t))
    for name, values in (("distance", distance), ("height", height)):
        wrong = ~np.isfinite(values)
        if wrong.any():
            raise start.refuse(part, f"the wanted {name} is not a number", float(t[wrong][0]))
    if (distance < 0.0).any():
        raise start.refuse(part, "the wanted distance is negative", float(t[distance < 0.0][0]))


def _require_target_below_mirror(
    target: Target, height_of: Callable[[Array], Array], start: Start, *, until_t: float, part: str
) -> None:
    t = np.linspace(start.t, until_t, 257)
    y = height_of(t)
    distance, height = (np.broadcast_to(np.asarray(a, dtype=np.float64), t.shape) for a in target(t))
    above = (height >= y + start.pinhole_height_m) & (distance <= t * y)
    if above.any():
        at = float(t[above][0])
        raise start.refuse(part, "the wanted point lies above the mirror, inside its own radius", at)
