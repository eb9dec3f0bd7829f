"""Painted and pasted objects on real floors: more colours, sizes and surroundings than the recordings show."""

from __future__ import annotations

import colorsys

import numpy as np
import patches
from numpy.typing import NDArray
from recordings import PERSON, ROBOT

COMPOSITES = 4000
AWAY, ASIDE = np.meshgrid(patches.PLACES * patches.BALL_STEP, patches.PLACES * patches.BALL_STEP, indexing="ij")
# Rows above the foot and columns of an obstacle's patch, metres.
UP, ACROSS = np.meshgrid(
    (np.arange(patches.SIDE) - patches.FOOT_ROW) * patches.OBSTACLE_STEP_M,
    patches.PLACES * patches.OBSTACLE_STEP_M,
    indexing="ij",
)

Colours = NDArray[np.float64]
Patches = NDArray[np.uint8]


def _levels(made: list[Colours]) -> Patches:
    return np.clip(np.array(made), 0, 255).astype(np.uint8)


def disc(radius: float, soft: float, away: float, aside: float, stretch: float = 1.0) -> Colours:
    """Soft mask of a disc in a ball's patch, radii; `stretch`: how much longer away from the robot."""
    return np.clip((radius + soft / 2 - np.hypot((AWAY - away) / stretch, ASIDE - aside)) / soft, 0, 1)[..., None]


def any_colour(rng: np.random.Generator, brightest: float = 1.0) -> Colours:
    """A colour of any hue, often pale or grey."""
    saturation = rng.choice([0, 0.1, 0.3, 0.6, 0.9])
    return np.array(colorsys.hsv_to_rgb(rng.random(), saturation, rng.uniform(0.25, 1) * brightest)) * 255


def painted_ball(rng: np.random.Generator) -> Colours:
    """A ball of any colour, sometimes of two colours."""
    ball = np.broadcast_to(any_colour(rng), (patches.SIDE, patches.SIDE, 3)).copy()
    if rng.random() < 0.3:
        angle = rng.uniform(0, 2 * np.pi)
        part = np.cos(angle) * ASIDE + np.sin(angle) * AWAY > rng.uniform(-0.5, 0.5)
        ball[part] = np.array(colorsys.hsv_to_rgb(rng.random(), rng.choice([0, 0.8]), rng.uniform(0.1, 1))) * 255
    return ball


def composite_balls(real: Colours, backgrounds: Colours, rng: np.random.Generator) -> Patches:
    """Real and painted balls on other places of the carpet, with shadows, partly hidden."""
    made = []
    for _ in range(COMPOSITES):
        ground = backgrounds[rng.integers(len(backgrounds))]
        if rng.random() < 0.1:
            ground = _feet(ground, rng, near=rng.uniform(0.3, 1.5))
        ball = real[rng.integers(len(real))] if rng.random() < 0.4 else painted_ball(rng)
        radius, away, aside = rng.uniform(0.85, 1.2), *rng.uniform(-0.35, 0.35, 2)
        # One lamp or window: its side of the ball is bright, even saturated, the other dark, and the shadow lies there.
        angle, depth, reach = rng.uniform(0, 2 * np.pi), rng.uniform(0, 1.2), rng.uniform(0, 1.3)
        light = np.sin(angle) * (AWAY - away) + np.cos(angle) * (ASIDE - aside)
        ball = np.clip(ball * np.exp(depth * light + rng.uniform(-0.3, 0.3))[..., None], 0, 255)
        shadow = disc(rng.uniform(0.8, 1.2) * radius, 0.8, away - reach * np.sin(angle), aside - reach * np.cos(angle))
        mask = disc(radius, rng.uniform(0.2, 0.9), away, aside, np.exp(rng.uniform(-0.1, 0.35)))
        patch = ground * (1 - shadow * rng.uniform(0, 0.8)) * (1 - mask) + ball * mask
        if rng.random() < 0.12:
            angle = rng.uniform(0, 2 * np.pi)
            patch[np.cos(angle) * ASIDE + np.sin(angle) * AWAY > rng.uniform(0.2, 0.7)] = rng.uniform(5, 70)
        inner, floor = np.hypot(AWAY, ASIDE) < 0.8, patches.FLOOR["ball"]
        contrast = np.log(patch[inner] + 8).mean(0) - np.log(ground[floor] + 8).mean(0)
        if np.abs(contrast).mean() > 0.18:
            made.append(patch)
    return _levels(made)


def _panel(ground: Colours, rng: np.random.Generator) -> Colours:
    """A coloured part of a robot, mostly in front of its dark body: round or long, as wide as a ball or narrower."""
    soft, side, end = rng.uniform(0.2, 0.8), rng.uniform(-1.5, 1.5), rng.uniform(1.5, 6)
    near = -rng.uniform(0.4, 2.4) + rng.uniform(0, 0.3) * (ASIDE - side) ** 2
    inside = np.minimum(rng.uniform(1.2, 4) - np.abs(ASIDE - side), np.minimum(AWAY - near, near + end - AWAY))
    body = np.clip(inside / soft + 0.5, 0, 1)[..., None]
    dark = any_colour(rng, 0.25) if rng.random() < 0.8 else any_colour(rng)
    patch = ground * (1 - body) + dark * body
    away, aside = rng.uniform(-0.6, 0.6, 2)
    if rng.random() < 0.4:
        mask = disc(rng.uniform(0.4, 1.2), soft, away, aside)
    else:
        angle = rng.uniform(0, 2 * np.pi)
        along = np.cos(angle) * (ASIDE - aside) + np.sin(angle) * (AWAY - away)
        across = np.sin(angle) * (ASIDE - aside) - np.cos(angle) * (AWAY - away)
        bent = across - rng.uniform(-0.2, 0.2) * along**2
        wide = np.minimum(rng.uniform(0.3, 1.0) - np.abs(bent), np.minimum(along + rng.uniform(0, 1), 4 - along))
        mask = np.clip(wide / soft + 0.5, 0, 1)[..., None]
    return patch * (1 - mask) + any_colour(rng) * mask


def _feet(ground: Colours, rng: np.random.Generator, near: float) -> Colours:
    """One or two shoes of a person, the nearer edge of the first at `near` (radii of a ball), and the legs, which lead away."""
    patch, aside = ground, rng.uniform(-0.5, 0.5)
    trousers = any_colour(rng, 0.3) if rng.random() < 0.7 else any_colour(rng)
    shoes = any_colour(rng, rng.choice([0.3, 1]))
    soft, lean = rng.uniform(0.2, 0.8), rng.uniform(-0.3, 0.3)
    for foot in range(rng.integers(1, 3)):
        heel = near + foot * rng.uniform(-1, 2)
        place = ASIDE - aside - foot * rng.choice([-1, 1]) * rng.uniform(0.8, 3.5)
        length, wide = rng.uniform(0.5, 2.2), rng.uniform(0.4, 1.2)
        # A shoe that points aside is as wide as it is long.
        shoe = np.hypot((AWAY - heel) / length - 0.5, 0.5 * place / wide)
        shoe_mask = np.clip((0.5 - shoe) * min(length, 2 * wide) / soft + 0.5, 0, 1)
        half = rng.uniform(0.3, 0.9) + rng.uniform(0, 0.2) * np.clip(AWAY - heel, 0, 4)
        across = np.abs(place - rng.uniform(-0.3, 0.3) - lean * (AWAY - heel))
        leg = np.minimum((half - across) / soft, (AWAY - heel - rng.uniform(0, 0.6) * length) / soft)
        leg_mask = np.clip(leg + 0.5, 0, 1)
        shadow = np.clip(1.5 - shoe, 0, 1) * rng.uniform(0, 0.5)
        patch = patch * (1 - shadow[..., None])
        for mask, colour in ((leg_mask, trousers), (shoe_mask, shoes)):
            patch = patch * (1 - mask[..., None]) + colour * mask[..., None]
    return patch


def composite_others(backgrounds: Colours, rng: np.random.Generator) -> Patches:
    """Discs and strips that are no ball: beside the centre, too large, too small, a line, feet of people."""
    made = []
    for _ in range(COMPOSITES):
        ground = backgrounds[rng.integers(len(backgrounds))]
        part = rng.random()
        if part < 0.6:
            made.append(_panel(ground, rng) if part < 0.4 else _feet(ground, rng, near=-rng.uniform(0.2, 3.5)))
            continue
        angle, choice = rng.uniform(0, 2 * np.pi), rng.random()
        if choice < 0.2:
            # A lamp or window that the carpet reflects: light is added, and there is no shadow.
            spot = disc(
                rng.uniform(0.4, 1.4), rng.uniform(0.8, 1.6), *rng.uniform(-0.5, 0.5, 2), np.exp(rng.uniform(-0.5, 0.7))
            )
            made.append(ground + rng.uniform(80, 400) * spot)
            continue
        if choice < 0.6:
            length = rng.uniform(1.0, 1.9)
            mask = disc(rng.uniform(0.8, 1.2), 0.4, length * np.sin(angle), length * np.cos(angle))
        elif choice < 0.75:
            mask = disc(rng.uniform(1.9, 3.5), 0.4, 0.3 * np.sin(angle), 0.3 * np.cos(angle))
        elif choice < 0.83:
            mask = disc(rng.uniform(0.2, 0.5), 0.3, 0, 0)
        else:
            # A line, rod or leg through the centre, narrower than a ball.
            across = np.cos(angle) * ASIDE + np.sin(angle) * AWAY - rng.uniform(-0.7, 0.7)
            mask = np.clip((rng.uniform(0.2, 0.85) - np.abs(across)) / rng.uniform(0.2, 0.6) + 0.5, 0, 1)[..., None]
        made.append(ground * (1 - mask) + painted_ball(rng) * mask)
    return _levels(made)


def _body(rng: np.random.Generator) -> tuple[Colours, Colours]:
    """Mask and colours of a robot: a base that is mostly dark, and above it panels of any colours."""
    half, foot, aside = rng.uniform(0.15, 0.3), rng.uniform(-0.08, 0.08), rng.uniform(-0.2, 0.2)
    soft = rng.uniform(0.03, 0.15)
    place = ACROSS - aside - rng.uniform(-0.15, 0.15) * UP
    # The near edge is straight, round or a corner.
    edge = foot + rng.uniform(0, 0.25) * (np.abs(place) / half) ** rng.choice([1, 2])
    taper = half * (1 + rng.uniform(-0.5, 0.2) * np.clip(UP, 0, 1))
    mask = np.clip((taper - np.abs(place)) / soft + 0.5, 0, 1) * np.clip((UP - edge) / soft + 0.5, 0, 1)
    base = any_colour(rng, 0.25) if rng.random() < 0.75 else any_colour(rng)
    colours = np.broadcast_to(base, (patches.SIDE, patches.SIDE, 3)).copy()
    for _ in range(rng.integers(0, 4)):
        panel = (rng.uniform(0.05, 0.6) < UP) & (np.abs(place - rng.uniform(-0.2, 0.2)) < rng.uniform(0.05, 0.4))
        colours[panel] = any_colour(rng)
    return mask, colours


def _legs(rng: np.random.Generator) -> tuple[Colours, Colours]:
    """Mask and colours of a person's one or two legs, shoes at the foot."""
    trousers = any_colour(rng, 0.3) if rng.random() < 0.7 else any_colour(rng)
    shoes = any_colour(rng, rng.choice([0.3, 1]))
    mask = np.zeros((patches.SIDE, patches.SIDE))
    colours = np.broadcast_to(trousers, (patches.SIDE, patches.SIDE, 3)).copy()
    aside, slope, soft = rng.uniform(-0.1, 0.1), rng.uniform(-0.25, 0.25), rng.uniform(0.03, 0.12)
    foot = rng.uniform(-0.08, 0.08)
    for leg in range(rng.integers(1, 3)):
        start = aside + leg * rng.choice([-1, 1]) * rng.uniform(0.15, 0.4)
        begin = foot + leg * rng.uniform(0, 0.25)
        place = ACROSS - start - (slope + rng.uniform(-0.1, 0.1)) * UP
        half = rng.uniform(0.04, 0.1) + rng.uniform(0, 0.06) * np.clip(UP, 0, 1)
        shoe = (begin + rng.uniform(0.04, 0.12) > UP) & (np.abs(place) < 0.15)
        wide = np.where(shoe, half + rng.uniform(0, 0.03), half)
        mask = np.maximum(mask, np.clip((wide - np.abs(place)) / soft + 0.5, 0, 1) * np.clip((UP - begin) / soft + 0.5, 0, 1))
        colours[shoe] = shoes
    return mask, colours


def _pasted(patch: Colours) -> tuple[Colours, Colours]:
    """Mask and colours of a recorded obstacle: what differs from the floor before it."""
    logs = np.log(patch + patches.LOG_OFFSET)
    apart = np.abs(logs - np.median(logs[: patches.FOOT_ROW].reshape(-1, 3), 0)).mean(-1)
    return np.clip((apart - 0.12) / 0.15, 0, 1) * np.clip(UP / 0.1 + 1.5, 0, 1), patch


def _shaded(mask: Colours, colours: Colours, ground: Colours, rng: np.random.Generator) -> Colours:
    """An object before a floor, with its shadow, in a light of its own."""
    gain = np.exp(rng.uniform(-0.4, 0.4) + rng.uniform(-0.3, 0.3) * ACROSS / 0.5)[..., None]
    shadow = rng.uniform(0, 0.4) * np.clip(1 - np.abs(UP) / rng.uniform(0.1, 0.4), 0, 1) * (np.abs(ACROSS) < 0.35)
    ground = ground * (1 - shadow[..., None])
    return ground * (1 - mask[..., None]) + np.clip(colours * gain, 0, 255) * mask[..., None]


def composite_obstacles(
    real: list[tuple[int, Patches]], backgrounds: Patches, rng: np.random.Generator
) -> tuple[Patches, NDArray[np.int_]]:
    """Painted and recorded robots and people on other floors, and their kinds."""
    made, kinds = [], []
    for _ in range(2 * COMPOSITES):
        ground = backgrounds[rng.integers(len(backgrounds))].astype(float)
        if real and rng.random() < 0.4:
            kind, patch = real[rng.integers(len(real))]
            mask, colours = _pasted(patch.astype(float))
            if rng.random() < 0.5:
                colours = colours[..., rng.permutation(3)]
        else:
            kind = ROBOT if rng.random() < 0.55 else PERSON
            mask, colours = _body(rng) if kind == ROBOT else _legs(rng)
        patch = _shaded(mask, colours, ground, rng)
        logs = np.log(patch + patches.LOG_OFFSET)
        floor = np.median(logs[: patches.FOOT_ROW].reshape(-1, 3), 0)
        if mask[UP > 0].sum() > 4 and np.abs(logs[mask > 0.7] - floor).mean() > 0.2:
            made.append(patch)
            kinds.append(kind)
    return _levels(made), np.array(kinds)


def _carpet_end(rng: np.random.Generator) -> tuple[Colours, Colours]:
    """Mask and colours of a line with what lies beyond the carpet or in a goal behind it, and of a post."""
    soft = rng.uniform(0.02, 0.12)
    line = UP - rng.uniform(-0.15, 0.15) - rng.uniform(-0.6, 0.6) * ACROSS
    begin = line - rng.uniform(0, 0.3)
    beyond = np.clip(begin / soft + 0.5, 0, 1)
    if rng.random() < 0.25:
        beyond = beyond * (rng.choice([-1, 1]) * ACROSS > rng.uniform(-0.3, 0.3))
    dark = any_colour(rng, rng.choice([0.3, 1.0]))
    colours = dark * np.exp(rng.normal(0, rng.uniform(0, 0.3), (patches.SIDE, 1, 1)))
    colours = np.broadcast_to(colours, (patches.SIDE, patches.SIDE, 3)).copy()
    white = np.clip((rng.uniform(0.02, 0.1) - np.abs(line)) / soft + 0.5, 0, 1) * (rng.random() < 0.7)
    if rng.random() < 0.4:
        post = rng.uniform(0.03, 0.12) - np.abs(ACROSS - rng.uniform(-0.4, 0.4) - rng.uniform(-0.3, 0.3) * UP)
        white = np.maximum(white, np.clip(post / soft + 0.5, 0, 1) * (begin > 0))
    level = rng.uniform(170, 255)
    colours = colours * (1 - white[..., None]) + level * white[..., None]
    return np.maximum(beyond, white), colours


def composite_no_obstacles(backgrounds: Patches, rng: np.random.Generator) -> Patches:
    """Lines, rods, cables, borders of the carpet, balls, glare: what looks like a foot and is none."""
    made = []
    for _ in range(COMPOSITES):
        ground = backgrounds[rng.integers(len(backgrounds))].astype(float)
        soft, choice = rng.uniform(0.02, 0.12), rng.random()
        colours = np.broadcast_to(any_colour(rng), ground.shape)
        if choice < 0.4:
            angle = rng.uniform(0, np.pi)
            up, aside = UP - rng.uniform(-0.1, 0.2), ACROSS - rng.uniform(-0.2, 0.2)
            across = np.cos(angle) * aside + np.sin(angle) * up
            half = rng.uniform(0.02, 0.12)
            mask = np.clip((half - np.abs(across)) / soft + 0.5, 0, 1)
            white = np.full(3, rng.uniform(190, 255)) if rng.random() < 0.6 else any_colour(rng, 0.25)
            colours = np.broadcast_to(white, ground.shape)
        elif choice < 0.7:
            mask, colours = _carpet_end(rng)
        elif choice < 0.8:
            edge = rng.uniform(-0.1, 0.1) + rng.uniform(-0.4, 0.4) * ACROSS
            mask = np.clip((UP - edge) / soft + 0.5, 0, 1)
        elif choice < 0.9:
            radius = np.hypot(ACROSS - rng.uniform(-0.1, 0.1), UP - rng.uniform(0.05, 0.15))
            mask = np.clip((rng.uniform(0.09, 0.14) - radius) / soft + 0.5, 0, 1)
        else:
            radius = np.hypot(ACROSS - rng.uniform(-0.3, 0.3), UP - rng.uniform(0.0, 0.4))
            mask = np.clip(1 - radius / rng.uniform(0.1, 0.4), 0, 1)
            colours = np.broadcast_to(np.full(3, 255.0), ground.shape)
        made.append(_shaded(mask, colours, ground, rng))
    return _levels(made)
