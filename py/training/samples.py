"""Which patches train the networks? Jittered objects, and all other places that the candidate search could offer."""

from __future__ import annotations

import numpy as np
import patches
from numpy.typing import NDArray
from recordings import IGNORED, NEGATIVE, Ball, Camera, Obstacle, Pixels, Samples
from view_angles import Floats

BALL_COPIES = 24
OBSTACLE_COPIES = 30
CHROMA_BINS = 48


def carpet_mask(camera: Camera, image: Pixels) -> NDArray[np.bool_]:
    """Pixels of the carpet's chromaticity: within the largest cluster near the robot, weighted towards green."""
    near = image[(camera.ranges > 0.25) & (camera.ranges < 4)].astype(int)
    total = near.sum(1)
    bright = near[total >= 60]
    red, green = (np.minimum(bright[:, i] * CHROMA_BINS // bright.sum(1), CHROMA_BINS - 1) for i in (0, 1))
    votes = np.zeros((CHROMA_BINS, CHROMA_BINS))
    np.add.at(votes, (red, green), 1)
    wide = np.pad(votes, 1)
    around = sum(wide[i : i + CHROMA_BINS, j : j + CHROMA_BINS] for i in range(3) for j in range(3))
    share = (np.arange(CHROMA_BINS) + 0.5) / CHROMA_BINS
    greenness = share[None] - np.maximum(share[:, None], 1 - share[:, None] - share[None])
    weight = 0.15 + np.clip(8 * (greenness + 0.02), 0, 0.85)
    r, g = np.unravel_index(np.argmax(around * weight), votes.shape)
    carpet = np.median(bright[(np.abs(red - r) <= 1) & (np.abs(green - g) <= 1)], 0)
    offset = carpet - carpet.mean()
    axis = offset / np.linalg.norm(offset)
    cross = np.array([axis[2] - axis[1], axis[0] - axis[2], axis[1] - axis[0]]) / np.sqrt(3)
    chroma = max(np.linalg.norm(offset) / carpet.mean(), 0.03)
    level = np.maximum(image.mean(-1), 1e-3)
    along, off = image @ axis / chroma / level, image @ cross / chroma / level
    return (along >= 0.35) & (np.abs(off) <= 0.45 * np.clip(along, 0.75, 1.25)) & (level >= 0.25 * carpet.mean())


def sample_image(
    camera: Camera, file: str, balls: list[Ball], obstacles: list[Obstacle] | None, rng: np.random.Generator
) -> Samples:
    """All patches of one image. Without `obstacles`, those of balls alone."""
    image = camera.image(file)
    carpet = carpet_mask(camera, image)
    samples = Samples(camera.folder.name)
    _sample_balls(camera, image, carpet, balls, samples, rng)
    if obstacles is not None:
        _sample_obstacles(camera, image, carpet, obstacles, samples, rng)
    return samples


def _sample_balls(
    camera: Camera, image: Pixels, carpet: NDArray[np.bool_], balls: list[Ball], samples: Samples, rng: np.random.Generator
) -> None:
    view, grid = camera.view, camera.ball_grid()
    u, v = patches.ball_positions(view, *grid.T)
    colours, inside = patches.read(image, u, v)
    on_carpet = patches.read(carpet, u, v)[0].astype(bool) & inside
    middle = patches.read(carpet, *view.positions(grid[:, 0], grid[:, 1]))[0].astype(bool)
    floor = on_carpet[:, patches.FLOOR["ball"]].mean(1)
    distance = np.full(len(grid), np.inf)
    for ball in balls:
        across = np.angle(np.exp(1j * (grid[:, 1] - ball.azimuth))) / ball.half_width
        distance = np.minimum(distance, np.hypot(across, (grid[:, 0] - ball.angle) / ball.half_height))
        if ball.usable:
            jitter = rng.uniform([-0.4, -0.4, 0.85], [0.4, 0.4, 1.2], (BALL_COPIES, 3))
            place = [np.full(BALL_COPIES, part) for part in (ball.angle, ball.azimuth, ball.half_height, ball.half_width)]
            samples.balls.append(patches.read(image, *patches.ball_positions(view, *place, jitter=jitter))[0])
    samples.ball_negatives = colours[~middle & (floor > 0.25) & (distance > 1.1)]
    plain = (floor > 0.8) & (distance > 2.5) & (rng.random(len(grid)) < 0.15)
    samples.ball_backgrounds = colours[plain]


def _edge_places(camera: Camera, image: Pixels, carpet: NDArray[np.bool_], grid: Floats) -> NDArray[np.bool_]:
    """Foot points with a step of colour above carpet."""
    view = camera.view
    logs = np.log(image + patches.LOG_OFFSET)
    step = patches.OBSTACLE_STEP_M / np.hypot(grid[:, 2], view.height_m)
    sides = []
    floors = []
    for side in (1.0, -1.0):
        places = [view.positions(grid[:, 0] + side * row * step, grid[:, 1]) for row in (1.0, 2.2)]
        sides.append(np.mean([patches.read(logs, *place)[0] for place in places], 0))
        floors.append(np.mean([patches.read(carpet, *place)[0] for place in places], 0))
    return (np.abs(sides[0] - sides[1]).mean(-1) > 0.2) & (floors[1] > 0.4)


def _sample_obstacles(
    camera: Camera,
    image: Pixels,
    carpet: NDArray[np.bool_],
    obstacles: list[Obstacle],
    samples: Samples,
    rng: np.random.Generator,
) -> None:
    view, grid = camera.view, camera.obstacle_grid()
    grid = grid[_edge_places(camera, image, carpet, grid)]
    step = patches.OBSTACLE_STEP_M / np.hypot(grid[:, 2], view.height_m)
    label = np.full(len(grid), NEGATIVE)
    for number, obstacle in enumerate(obstacles):
        offset = np.angle(np.exp(1j * (grid[:, 1] - obstacle.azimuth)))
        half = obstacle.offsets[-1]
        near = np.interp(offset, obstacle.offsets, obstacle.near_angles)
        above = (grid[:, 0] - near) / step
        # Beside and above the foot: neither an example nor a counterexample.
        label[(np.abs(offset) < half + 0.25 / grid[:, 2]) & (above > -2.5)] = IGNORED
        if obstacle.kind == IGNORED:
            continue
        lowest = obstacle.near_angles.min()
        for _ in range(OBSTACLE_COPIES):
            place = rng.integers(3, 22)
            angle, azimuth = obstacle.near_angles[place], obstacle.azimuth + obstacle.offsets[place]
            range_m = view.height_m * np.tan(min(angle, 1.5))
            if range_m > 6.5 or angle > lowest + 4 * patches.OBSTACLE_STEP_M / np.hypot(range_m, view.height_m):
                continue
            jitter = np.array([[rng.uniform(-0.8, 0.8), rng.uniform(-0.03, 0.03), rng.uniform(0.85, 1.2)]])
            u, v = patches.obstacle_positions(view, *(np.array([part]) for part in (angle, azimuth, range_m)), jitter=jitter)
            colours, inside = patches.read(image, u, v)
            samples.obstacles.append((obstacle.kind, number, colours[0], inside[0]))
    free = grid[label == NEGATIVE]
    samples.obstacle_negatives, samples.obstacle_inside = patches.read(image, *patches.obstacle_positions(view, *free.T))
