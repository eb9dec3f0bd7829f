"""Finds the mirror that satisfies requirements best, and the requirements that exclude each other.

The unknown is how fast the outgoing ray's angle γ grows with the camera slope t; with γ(t) the tangent follows from the law of
reflection, and the profile from one quadrature. A requirement's satisfaction m is the ratio of the resolution achieved
to the one required, or of the permitted diameter to the one achieved. The optimiser maximises one m common to all
requirements. Above 1 all are satisfied with that margin. Below 1 they conflict, and leaving them out one by one finds which do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy
from tqdm import tqdm

from mirrorball._core import Camera
from mirrorball.arguments import checked
from mirrorball.mirror.parts import Free
from mirrorball.mirror.profile_design import Mirror, design
from mirrorball.mirror.reflection import Array


@checked
@dataclass(frozen=True, kw_only=True)
class Resolution:
    """At least this many pixels per metre of ground between two distances."""

    from_m: float
    to_m: float
    px_per_m: float
    direction: Literal["radial", "tangential"] = "radial"
    hard: bool = False

    def __str__(self) -> str:
        """As conflicts name it."""
        return f"{self.direction} resolution {self.px_per_m:g} px/m from {self.from_m:g} to {self.to_m:g} m"


@checked
@dataclass(frozen=True, kw_only=True)
class Heights:
    """Visible heights at a distance, with at least `px` pixels between the lowest and the highest."""

    at_m: float
    from_height_m: float = 0.0
    to_height_m: float
    px: float = 10.0
    hard: bool = False

    def __str__(self) -> str:
        """As conflicts name it."""
        return f"heights {self.from_height_m:g} to {self.to_height_m:g} m at {self.at_m:g} m with {self.px:g} px"


@checked
@dataclass(frozen=True, kw_only=True)
class MaxDiameter:
    """The rim no wider than this."""

    diameter_m: float
    hard: bool = False

    def __str__(self) -> str:
        """As conflicts name it."""
        return f"diameter at most {1e3 * self.diameter_m:g} mm"


@checked
@dataclass(frozen=True, kw_only=True)
class MinCurvatureRadius:
    """No bend of the meridian tighter than this, convex or concave: the tool must fit."""

    radius_m: float
    hard: bool = False

    def __str__(self) -> str:
        """As conflicts name it."""
        return f"radius of curvature at least {1e3 * self.radius_m:g} mm"


Requirement = Resolution | Heights | MaxDiameter | MinCurvatureRadius


@dataclass(frozen=True)
class OptimisationResult:
    """The best mirror and how it satisfies the requirements."""

    mirror: Mirror
    part: Free
    """The one part it is made of: its `target` is the map that was found."""
    share: float
    """Smallest satisfaction of all requirements; at least 1 if all are satisfied."""
    met: tuple[tuple[Requirement, float], ...]
    """Each requirement with its own satisfaction."""
    conflicts: tuple[Requirement, ...]
    """Requirements that cannot be met together although without any one of them the others can; empty if all are met."""


KNOTS = 12
"""Of ln dγ/dt; a cubic through them bends as finely as a lathe would follow."""
RAY_COUNT = 301
"""Rays per candidate."""
MAX_GROUND_ANGLE = 1.565
"""Rays closer to level than a third of a degree see the ground too far away to count, radians."""
MIN_FACING = 0.05
"""1 − t·Y′ stays above this, so that no ray grazes the mirror."""
SATISFIED_RATIO = 1.0 - 1e-3
"""A share this close to 1 counts as met; the optimiser stops no closer."""


@dataclass(frozen=True)
class _Candidate:
    """A profile on the grid of camera slopes, with everything the requirements ask about."""

    t: Array
    gamma: Array
    x: Array
    y: Array
    slope: Array
    curvature: Array
    ground: Array
    ground_rate: Array
    """Of the ground distance along t."""
    pinhole_height_m: float

    def gamma_to(self, distance_m: float, height_m: float) -> float:
        """Angle at which the rim would see a point."""
        return float(np.arctan2(distance_m - self.x[-1], self.y[-1] + self.pinhole_height_m - height_m))


class _Problem:
    """Requirements as logarithms of shares: one number per place where a requirement must hold."""

    def __init__(self, requirements: Sequence[Requirement], *, camera: Camera, pinhole_height_m: float, apex_m: float) -> None:
        self.requirements = tuple(requirements)
        self.focal_px = camera.focal_px
        half = (min(camera.width_px, camera.height_px) - 1) / 2.0
        self.t_max = (camera.outer_radius_px or half) / camera.focal_px
        self.pinhole_height_m = pinhole_height_m
        self.apex_m = apex_m
        self.u = np.linspace(0.0, 1.0, RAY_COUNT)
        self.last: tuple[bytes, _Candidate] | None = None
        self.basis = np.asarray(scipy.interpolate.CubicSpline(np.linspace(0.0, 1.0, KNOTS), np.eye(KNOTS))(self.u))

    def candidate(self, unknowns: Array) -> _Candidate:
        """Unknowns: ln dγ/du at the knots, then ln of the rim's t."""
        key = unknowns[: KNOTS + 1].tobytes()
        if self.last is None or self.last[0] != key:
            self.last = key, self._trace_candidate(unknowns)
        return self.last[1]

    def _trace_candidate(self, unknowns: Array) -> _Candidate:
        rim = float(np.exp(unknowns[KNOTS]))
        rate = np.exp(np.clip(self.basis @ unknowns[:KNOTS], -12.0, 12.0))
        gamma = _cumulative_trapezoid(rate, 1.0)
        t = rim * self.u
        slope = np.tan(np.clip((gamma - np.arctan(t)) / 2.0, -1.5, 1.5))
        facing = 1.0 - t * slope
        steep = _cumulative_trapezoid(slope / np.maximum(facing, 1e-3), rim)
        y = self.apex_m * np.exp(np.clip(steep, -5.0, 5.0))
        alpha_rate = (rate / rim - 1.0 / (1.0 + t**2)) / 2.0
        curvature = alpha_rate * facing / (y * np.hypot(1.0, slope))
        # Beyond the horizon the ground goes on at a great distance, so that it stays a rising function of t.
        down = np.minimum(gamma, MAX_GROUND_ANGLE)
        drop = y + self.pinhole_height_m
        x_rate = y / np.maximum(facing, 1e-3)
        return _Candidate(
            t=t,
            gamma=gamma,
            x=t * y,
            y=y,
            slope=slope,
            curvature=curvature,
            ground=t * y + drop * np.tan(down),
            ground_rate=x_rate * (1.0 + slope * np.tan(down)) + drop * rate / rim / np.cos(down) ** 2,
            pinhole_height_m=self.pinhole_height_m,
        )

    def reach(self) -> list[tuple[float, float]]:
        """Points that some ray must see whatever the share."""
        ground = [(requirement.to_m, 0.0) for requirement in self.requirements if isinstance(requirement, Resolution)]
        return ground + [
            (requirement.at_m, requirement.to_height_m) for requirement in self.requirements if isinstance(requirement, Heights)
        ]

    def shares(self, requirement: Requirement, found: _Candidate) -> Array:
        """Ln of how far the requirement is met, at each place where it must hold."""
        if isinstance(requirement, Resolution):
            return self._log_resolution_ratio(requirement, found)
        if isinstance(requirement, Heights):
            low, high = (
                _slope_seeing_point(found, requirement.at_m, h) for h in (requirement.from_height_m, requirement.to_height_m)
            )
            return np.log(np.maximum([(high - low) * self.focal_px / requirement.px], 1e-6))
        if isinstance(requirement, MaxDiameter):
            return np.log([requirement.diameter_m / (2.0 * found.x[-1])])
        return -np.log(np.maximum(np.abs(found.curvature[::5]) * requirement.radius_m, 1e-3))

    def _log_resolution_ratio(self, requirement: Resolution, found: _Candidate) -> Array:
        distance = np.geomspace(max(requirement.from_m, 1e-3), requirement.to_m, 48)
        if requirement.direction == "tangential":
            px_per_m = self.focal_px * np.interp(distance, found.ground, found.t) / distance
        else:
            px_per_m = self.focal_px / np.interp(distance, found.ground, found.ground_rate)
        return np.asarray(np.log(np.maximum(px_per_m / requirement.px_per_m, 1e-6)))

    def limits(self, unknowns: Array) -> Array:
        """What must hold whatever the share: reach, no folding, the lens, hard requirements."""
        found = self.candidate(unknowns)
        reach = [found.gamma[-1] - found.gamma_to(*point) for point in self.reach()]
        facing = (1.0 - found.t * found.slope - MIN_FACING)[::20]
        hard = [self.shares(requirement, found) for requirement in self.requirements if requirement.hard]
        return np.concatenate([reach, facing, [np.log(self.t_max) - unknowns[KNOTS]], *hard])

    def soft(self, unknowns: Array) -> Array:
        """Logarithm of the share minus the common one: positive where a requirement is met better than that."""
        found = self.candidate(unknowns)
        parts = [self.shares(requirement, found) for requirement in self.requirements if not requirement.hard]
        return np.asarray(np.concatenate([*parts, np.zeros(0)]) - unknowns[KNOTS + 1])

    def holds(self, unknowns: Array) -> Array:
        """Everything that must not be negative, for the solver."""
        return np.concatenate([self.limits(unknowns), self.soft(unknowns)])

    def start(self, rim: float) -> Array:
        """An even map of the ground out to the furthest point."""
        flat = replace(self.candidate(np.append(np.zeros(KNOTS), np.log(rim))), y=np.full(RAY_COUNT, 1.2 * self.apex_m))
        end = np.tan(min(max(flat.gamma_to(*point) for point in self.reach()) + 0.02, 1.5))
        u = np.linspace(0.0, 1.0, KNOTS)
        unknowns = np.append(np.log(end / (1.0 + (u * end) ** 2)), [np.log(rim), 0.0])
        soft = self.soft(unknowns)
        unknowns[-1] = float(soft.min()) if soft.size else 0.0
        return unknowns


def _cumulative_trapezoid(rate: Array, length: float) -> Array:
    """From the axis outwards, by trapezoids: the mirror itself is integrated exactly, later."""
    total = np.zeros(RAY_COUNT)
    np.cumsum(rate[1:] + rate[:-1], out=total[1:])
    return np.asarray(total * (length / (2 * (RAY_COUNT - 1))))


def _slope_seeing_point(found: _Candidate, distance_m: float, height_m: float) -> float:
    """Camera slope of the ray that passes a point; at the rim if none does."""
    wanted = np.arctan2(distance_m - found.x, found.y + found.pinhole_height_m - height_m)
    return float(np.interp(0.0, found.gamma - wanted, found.t))


# Restarts of the solver from its own result, and the gain in ln(share) for which another one is worthwhile.
RESTARTS_MAX = 6
RESTART_GAIN_MIN = 1e-3


def _solve(problem: _Problem, starts: Sequence[Array], *, enough: float = 20.0) -> tuple[Array, float]:
    """Unknowns and how badly the limits are broken (0: not at all); stops at a share that is enough."""
    smooth = np.diff(np.eye(KNOTS), n=2, axis=0)

    def cost(unknowns: Array) -> float:
        # A weak smoothness term determines what no requirement constrains.
        return float(-unknowns[-1] + 1e-4 * np.sum((smooth @ unknowns[:KNOTS]) ** 2))

    best, broken = np.asarray(starts[0]), np.inf
    capped = [(-12.0, 12.0)] * KNOTS + [(np.log(1e-2), np.log(problem.t_max)), (-8.0, np.log(enough))]

    def rank(found: Array, harm: float) -> tuple[bool, float]:
        return (harm < 1e-4, float(found[-1]) if harm < 1e-4 else -harm)

    for begin in starts:
        previous = (False, -np.inf)
        # SLSQP may stop early, depending on the rounding of the machine's BLAS. A restart discards its Hessian estimate.
        for _ in range(RESTARTS_MAX):
            result = scipy.optimize.minimize(
                cost,
                begin,
                method="SLSQP",
                bounds=capped,
                constraints={"type": "ineq", "fun": problem.holds},
                options={"maxiter": 150, "ftol": 1e-7},
            )
            found = np.asarray(result.x)
            # Recomputed from the requirements: the solver's own variable is within its tolerance of this.
            soft = problem.soft(np.append(found[:-1], 0.0))
            found[-1] = float(soft.min()) if soft.size else 0.0
            harm = float(max(-problem.limits(found).min(), 0.0))
            if rank(found, harm) > rank(best, broken):
                best, broken = found, harm
            if broken < 1e-4 and best[-1] >= np.log(enough) - 1e-6:
                return best, broken
            if rank(found, harm)[0] == previous[0] and rank(found, harm)[1] < previous[1] + RESTART_GAIN_MIN:
                break
            previous, begin = rank(found, harm), found
    return best, broken


def _is_feasible(problem: _Problem, near: Array) -> bool:
    found, broken = _solve(problem, [near, problem.start(0.95 * problem.t_max)], enough=1.0)
    return broken < 1e-4 and bool(found[-1] >= np.log(SATISFIED_RATIO))


@checked
def optimise(
    requirements: Sequence[Requirement],
    *,
    camera: Camera,
    apex_above_pinhole_m: float,
    name: str = "optimised",
    progress: bool = True,
) -> OptimisationResult:
    """Finds the free part that satisfies the requirements best.

    The camera gives focal length, pinhole height and the image's edge. Requirements marked `hard` are constraints.
    ValueError if requirements are invalid, or if no mirror satisfies the hard ones.
    """
    _validate(requirements)
    build: Callable[[Sequence[Requirement]], _Problem] = lambda kept: _Problem(  # noqa: E731
        kept, camera=camera, pinhole_height_m=camera.pinhole_height_m, apex_m=apex_above_pinhole_m
    )
    problem = build(requirements)
    soft = [requirement for requirement in requirements if not requirement.hard]
    with tqdm(total=1 + len(soft), unit="search", disable=not progress, leave=False) as bar:
        starts = [problem.start(share * problem.t_max) for share in (0.95, 0.6)]
        best, broken = _solve(problem, starts)
        bar.update()
        if broken >= 1e-4:
            hard = (
                "; ".join(str(requirement) for requirement in requirements if requirement.hard)
                or "reaching the furthest requirement"
            )
            raise ValueError(f"no mirror 1 − t·Y′ > {MIN_FACING} under this lens can have: {hard}")
        conflicts = list(soft) if best[-1] < np.log(SATISFIED_RATIO) else []
        for requirement in list(conflicts):
            without = build([kept for kept in requirements if kept.hard or (kept in conflicts and kept is not requirement)])
            bar.update()
            if without.reach() and not _is_feasible(without, best):
                conflicts.remove(requirement)
    found = problem.candidate(best)
    part = Free(target=_target_map(found, problem.reach()), until_t=float(found.t[-1]), tangent_continuous=True, name=name)
    mirror = design([part], pinhole_height_m=camera.pinhole_height_m, apex_above_pinhole_m=apex_above_pinhole_m, name=name)
    met = tuple((requirement, float(np.exp(problem.shares(requirement, found).min()))) for requirement in requirements)
    return OptimisationResult(
        mirror=mirror, part=part, share=float(np.exp(best[-1])) if soft else 1.0, met=met, conflicts=tuple(conflicts)
    )


def _validate(requirements: Sequence[Requirement]) -> None:
    if not any(isinstance(requirement, Resolution | Heights) for requirement in requirements):
        raise ValueError("no requirement of a resolution or of heights: nothing says what the mirror should see")
    for requirement in requirements:
        values = {key: value for key, value in vars(requirement).items() if isinstance(value, float | int)}
        wrong = [key for key, value in values.items() if value < 0.0]
        if wrong:
            raise ValueError(f"{requirement}: {wrong[0]} = {values[wrong[0]]} must not be negative")
        if isinstance(requirement, Resolution) and not requirement.from_m < requirement.to_m:
            raise ValueError(f"{requirement}: from_m must be less than to_m")
        if isinstance(requirement, Heights) and not requirement.from_height_m < requirement.to_height_m:
            raise ValueError(f"{requirement}: from_height_m must be less than to_height_m")


def _target_map(found: _Candidate, reach: Sequence[tuple[float, float]]) -> Callable[[Array], tuple[Array, Array]]:
    """T ↦ (distance, height): along the ground to the furthest requirement, then up a wall there."""
    wall = max(distance for distance, _ in reach)
    foot = np.arctan2(wall - found.x, found.y + found.pinhole_height_m)
    low = found.gamma <= foot
    # Rays that come down are asked where they meet the ground, the others how high they meet the wall; each curve is
    # carried some rays past the foot, so that neither spline ends where it is used. The ground's is laid through the
    # angle below the apex, which stays smooth up to the horizon.
    count = int(low.sum())
    near = slice(0, min(count + 5, RAY_COUNT))
    high = found.y[0] + found.pinhole_height_m
    below = scipy.interpolate.CubicSpline(found.t[near], np.arctan(found.ground / high)[near])
    if count > RAY_COUNT - 5:
        return _GroundThenWall(apex_height_m=high, below=below)
    far = slice(max(count - 5, 1), RAY_COUNT)
    rise = found.y + found.pinhole_height_m - (wall - found.x) / np.tan(np.maximum(found.gamma, 1e-6))
    height = scipy.interpolate.CubicSpline(found.t[far], rise[far])
    past = (found.gamma - foot)[count - 1 : count + 1]
    t_foot = float(np.interp(0.0, past, found.t[count - 1 : count + 1]))

    return _GroundThenWall(apex_height_m=high, below=below, wall_m=wall, t_foot=t_foot, height=height)


@dataclass(frozen=True, kw_only=True)
class _GroundThenWall:
    """Along the ground, then up a wall if there is one. A class, so that a mirror can be pickled."""

    apex_height_m: float
    below: Callable[[Array], Array]
    """Angle below the apex at which a ray meets the ground."""
    wall_m: float = np.inf
    t_foot: float = np.inf
    height: Callable[[Array], Array] | None = None

    def __call__(self, t: Array) -> tuple[Array, Array]:
        ground = self.apex_height_m * np.tan(self.below(np.minimum(t, self.t_foot)))
        if self.height is None:
            return np.asarray(ground), np.zeros_like(t)
        flat = t <= self.t_foot
        return np.where(flat, ground, self.wall_m), np.where(flat, 0.0, self.height(np.maximum(t, self.t_foot)))
