"""Trains the networks that judge balls, robots and people by their pixels; writes objects.weights.

`python py/training/prepare_recordings.py --mirrorball EXE --labelled REAL --out DIR`
`OPENBLAS_NUM_THREADS=1 python py/training/train_objects.py --prepared DIR --out crates/vision/src/objects/objects.weights`

gives the weights of the repository. `--leave-out labelled_Y3` trains without a camera, for a test on its pictures.
Labelled folders hold object_labels.csv; a map and a centre may follow after colons. Simulated folders are exports of
logs (`mirrorball replay LOG --export DIR`). Equal inputs and seeds give equal weights on one kind of processor.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import patches
from composites import composite_balls, composite_no_obstacles, composite_obstacles, composite_others
from networks import CoarseNetwork, Network, PatchNetwork, logistic, softmax, write_reference, write_weights
from numpy.typing import NDArray
from prepare_recordings import drives
from recordings import PERSON, Camera, Samples, labelled_objects, simulated_objects
from samples import sample_image

EPOCHS = 8
BATCH_POSITIVE = 64
POOL = 24000
# Share of painted and pasted obstacles among those of a batch.
PAINTED = 0.25
CHANNEL_ORDERS = [(0, 1, 2), (0, 2, 1), (1, 0, 2), (2, 1, 0), (1, 2, 0), (2, 0, 1)]

Colours = NDArray[np.float64]
Floats32 = NDArray[np.float32]


def _blurred(patch: Floats32, rng: np.random.Generator) -> Floats32:
    """Blur of a third of the patches, along and across the view by different amounts."""
    for axis in (1, 2):
        share = (rng.uniform(0, 0.33, (len(patch), 1, 1, 1)) * (rng.random((len(patch), 1, 1, 1)) < 0.35)).astype(np.float32)
        padded = np.concatenate([patch.take([0], axis), patch, patch.take([-1], axis)], axis)
        side = patch.shape[axis]
        around = padded.take(range(side), axis) + padded.take(range(2, side + 2), axis)
        patch = (1 - 2 * share) * patch + share * around
    return patch


def augment(colours: NDArray[np.generic], rng: np.random.Generator) -> Floats32:
    """Another camera's picture of the same: mirrored, blurred, other colours, exposure, saturation, noise, veiling light."""
    count = len(colours)
    each = (count, 1, 1, 1)

    def uniform(low: float, high: float, shape: tuple[int, ...] = each) -> Floats32:
        return rng.uniform(low, high, shape).astype(np.float32)

    patch = colours.astype(np.float32)
    mirrored = rng.random(count) < 0.5
    patch[mirrored] = patch[mirrored][:, :, ::-1]
    patch = _blurred(patch, rng)
    order = rng.integers(len(CHANNEL_ORDERS), size=count)
    patch = np.take_along_axis(patch, np.array(CHANNEL_ORDERS)[order][:, None, None], 3)
    grey = patch.mean(3, keepdims=True)
    patch = np.clip(grey + (patch - grey) * np.exp(uniform(-0.5, 0.4)), 0, 255)
    patch = 255 * (patch / 255) ** np.exp(uniform(-0.3, 0.3))
    # A bright picture saturates.
    patch = np.minimum(patch * np.exp(uniform(-0.35, 0.35, (count, 1, 1, 3)) + uniform(-0.3, 0.4)), 255)
    patch += rng.standard_normal(patch.shape, np.float32) * uniform(0, 6)
    veil = uniform(0, 0.15)
    return np.clip(patch * (1 - veil) + veil * uniform(60, 200), 0, 255)


def _hardness(network: PatchNetwork, kind: str, colours: NDArray[np.generic], inside: NDArray[np.bool_]) -> Colours:
    """Probability with which each counterexample is drawn: the more it looks like an object, the more often."""
    scores = []
    for start in range(0, len(colours), 2000):
        part = slice(start, start + 2000)
        outputs = network.forward(patches.normalize(kind, colours[part], inside[part]))
        scores.append(logistic(outputs)[:, 0] if kind == "ball" else 1 - softmax(outputs)[:, 0])
    hardness = np.concatenate(scores).astype(float) + 0.01
    return hardness / hardness.sum()


def balanced(groups: list[Colours]) -> Colours:
    """Shares of all entries' weights such that each group has the same total."""
    return np.concatenate([group / max(group.sum(), 1e-9) / len(groups) for group in groups])


def _even(parts: list[int], is_labelled: list[bool]) -> Colours:
    """Shares of pictures' counterexamples: photographs and simulated images have half each."""
    labelled = np.repeat(is_labelled, parts)
    groups = [part.astype(float) for part in (labelled, ~labelled) if part.any()]
    return np.asarray(sum(group / group.sum() for group in groups) / len(groups))


def train(
    kind: str,
    objects: tuple[NDArray[np.generic], NDArray[np.bool_], NDArray[np.int_], Colours],
    others: tuple[NDArray[np.generic], NDArray[np.bool_], Colours],
    *,
    steps: int,
    seed: int,
) -> tuple[CoarseNetwork, PatchNetwork]:
    """Trains both networks of a kind. `objects`: patches, inside, class and share; `others`: patches, inside, share."""
    rng = np.random.default_rng(seed)
    colours, inside, labels, weights = objects
    outputs = 1 if kind == "ball" else 3
    network = PatchNetwork(patches.SIDE, outputs, seed)
    coarse = CoarseNetwork(3 * len(patches.COARSE) ** 2, seed)
    negatives = 2 * BATCH_POSITIVE
    total = BATCH_POSITIVE + negatives
    is_object = np.r_[np.ones(BATCH_POSITIVE), np.zeros(negatives)].astype(np.float32)[:, None]
    for epoch in range(EPOCHS):
        rate = 0.002 * (1 + np.cos(np.pi * epoch / EPOCHS)) + 1e-4
        # The hard ones of other counterexamples in each epoch.
        pool = rng.choice(len(others[0]), POOL, p=others[2])
        hard = _hardness(network, kind, others[0][pool], others[1][pool]) if epoch else np.full(POOL, 1 / POOL)
        for _ in range(steps):
            positive = rng.choice(len(colours), BATCH_POSITIVE, p=weights)
            negative = rng.choice(pool, negatives, p=hard)
            patch = augment(np.concatenate([colours[positive], others[0][negative]]), rng)
            known = np.concatenate([inside[positive], others[1][negative]])
            result = network.forward(patches.normalize(kind, patch, known))
            if kind == "ball":
                error = logistic(result) - is_object
            else:
                wanted = np.zeros((total, outputs), np.float32)
                wanted[np.arange(BATCH_POSITIVE), labels[positive]] = 1
                wanted[BATCH_POSITIVE:, 0] = 1
                error = softmax(result) - wanted
            network.step(network.backward((error / total).astype(np.float32)), rate)
            # The coarse network meets all places, not only the hard ones.
            easy = rng.integers(len(others[0]), size=negatives)
            patch = np.concatenate([patch[:BATCH_POSITIVE], augment(others[0][easy], rng)])
            known = np.concatenate([inside[positive], others[1][easy]])
            result = coarse.forward(patches.normalize(kind, patches.coarse(patch), patches.coarse(known)))
            coarse.step(coarse.backward(((logistic(result) - is_object) / total).astype(np.float32)), rate)
        print(f"{kind}: epoch {epoch + 1} of {EPOCHS}", flush=True)
    return coarse, network


def train_ball(samples: list[Samples], simulated: set[str], *, steps: int, seed: int) -> list[Network]:
    """Networks of the ball; photographs, simulated images and composites weigh the same."""
    rng = np.random.default_rng(seed)
    real = np.concatenate([ball for sample in samples for ball in sample.balls]).astype(float)
    is_labelled = np.concatenate([np.full(sum(map(len, sample.balls)), sample.camera not in simulated) for sample in samples])
    backgrounds = np.concatenate([sample.ball_backgrounds for sample in samples]).astype(float)
    composites = composite_balls(real, backgrounds, rng)
    wrong = composite_others(backgrounds, rng)
    others = np.concatenate([*(sample.ball_negatives for sample in samples), wrong])
    colours = np.concatenate([real.astype(np.uint8), composites])
    counts = [len(sample.ball_negatives) for sample in samples]
    labelled = [sample.camera not in simulated for sample in samples]
    share = _even([*counts, len(wrong)], [*labelled, False])
    groups = [is_labelled.astype(float), (~is_labelled).astype(float)]
    groups = [group / max(group.sum(), 1e-9) for group in groups]
    weights = balanced([groups[0] + groups[1], np.full(len(composites), 1.0)])
    everywhere = [np.ones(part.shape[:3], bool) for part in (colours, others)]
    labels = np.ones(len(colours), int)
    return list(
        train("ball", (colours, everywhere[0], labels, weights), (others, everywhere[1], share), steps=steps, seed=seed)
    )


def train_obstacle(samples: list[Samples], simulated: set[str], *, steps: int, seed: int) -> list[Network]:
    """Networks of robots and people; each object of a photograph weighs the same, and all simulated ones half as much."""
    colours, inside, labels, weights, labelled = [], [], [], [], []
    for sample in samples:
        counts = np.bincount([number for _, number, _, _ in sample.obstacles], minlength=1)
        for kind, number, patch, known in sample.obstacles:
            colours.append(patch)
            inside.append(known)
            labels.append(kind)
            weights.append((1.3 if kind == PERSON else 1.0) / counts[number])
            labelled.append(sample.camera not in simulated)
    weight, is_labelled = np.array(weights), np.array(labelled)
    shares = [part * weight / max((part * weight).sum(), 1e-9) for part in (is_labelled, ~is_labelled)]
    share = 2 * shares[0] + shares[1]
    rng = np.random.default_rng(seed)
    negatives = np.concatenate([sample.obstacle_negatives for sample in samples])
    known = np.concatenate([sample.obstacle_inside for sample in samples])
    clear = negatives[known.all((1, 2))]
    painted, kinds = composite_obstacles(list(zip(labels, colours, strict=True)), clear, rng)
    wrong = composite_no_obstacles(clear, rng)
    everywhere = [np.ones(part.shape[:3], bool) for part in (painted, wrong)]
    objects = (
        np.concatenate([np.array(colours), painted]),
        np.concatenate([np.array(inside), everywhere[0]]),
        np.concatenate([np.array(labels), kinds]),
        np.concatenate([(1 - PAINTED) * share / share.sum(), np.full(len(painted), PAINTED / len(painted))]),
    )
    counts = [len(sample.obstacle_negatives) for sample in samples]
    even = _even([*counts, len(wrong)], [*(sample.camera not in simulated for sample in samples), False])
    others = (
        np.concatenate([negatives, wrong]),
        np.concatenate([known, everywhere[1]]),
        even,
    )
    return list(train("obstacle", objects, others, steps=steps, seed=seed))


def labelled_camera(text: str) -> Camera:
    """A camera of `FOLDER[:MAP.npz[:U:V]]`."""
    folder, *rest = text.split(":")
    centre = (float(rest[1]), float(rest[2])) if len(rest) == 3 else None
    return Camera(Path(folder), map_file=Path(rest[0]) if rest else None, centre_px=centre)


def main() -> None:
    """Reads the recordings, trains, writes the weights."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prepared", type=Path, metavar="DIR", help="recordings of prepare_recordings.py")
    parser.add_argument("--leave-out", default="", metavar="NAME", help="labelled recording of DIR not to train on")
    parser.add_argument("--labelled", action="append", default=[], metavar="DIR[:MAP[:U:V]]")
    parser.add_argument("--simulated", action="append", default=[], metavar="DIR")
    parser.add_argument("--steps", type=int, default=400, help="steps of each of the eight epochs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    if args.prepared:
        names = [name for name in ("labelled_Y3", "labelled_Y1") if name != args.leave_out]
        args.labelled += [str(args.prepared / name) for name in names]
        args.simulated += [str(args.prepared / name) for name in drives()]
    samples = []
    recordings = [(labelled_camera(text), True) for text in args.labelled]
    recordings += [(Camera(Path(text)), False) for text in args.simulated]
    for camera, labelled in recordings:
        objects = labelled_objects(camera) if labelled else simulated_objects(camera)
        # Its own numbers, so that leaving a recording out changes no other's patches.
        rng = np.random.default_rng(args.seed)
        for stamp, file in camera.frames:
            balls, obstacles = objects.get(stamp, ([], []))
            samples.append(sample_image(camera, file, balls, obstacles, rng))
        print(f"{camera.folder}: {len(camera.frames)} pictures", flush=True)
    simulated = {Path(text).name for text in args.simulated}
    networks = train_ball(samples, simulated, steps=args.steps, seed=args.seed)
    networks += train_obstacle(samples, simulated, steps=args.steps, seed=args.seed)
    write_weights(args.out, networks)
    write_reference(args.out.with_suffix(".reference"), networks)


if __name__ == "__main__":
    main()
