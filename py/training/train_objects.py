"""Trains the networks that judge balls, robots and people by their pixels; writes objects.weights.

`python py/training/prepare_recordings.py --mirrorball EXE --labelled REAL --out DIR`
`OPENBLAS_NUM_THREADS=1 python py/training/train_objects.py --prepared DIR --screens W --out W`

with W = crates/vision/src/objects/objects.weights gives the weights of the repository, whose coarse networks and screens are
of an earlier training (docs/experiments.md). Without `--screens` all are trained. It takes half an hour of two cores.
`--leave-out labelled_Y3` trains without a camera, for a test on its pictures.
Labelled folders hold object_labels.csv; a map and a centre may follow after colons. Simulated folders are exports of
logs (`mirrorball replay LOG --export DIR`). Equal inputs and seeds give equal weights on one kind of processor.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import patches
from augmentation import MILD, STRONG, Variation, augment, contrast
from example_patches import Examples, ball_examples, obstacle_examples
from networks import (
    JUDGE,
    SCREEN,
    Array,
    CoarseNetwork,
    Network,
    PatchNetwork,
    Size,
    logistic,
    object_networks,
    read_weights,
    softmax,
    write_reference,
    write_weights,
)
from numpy.typing import NDArray
from prepare_recordings import drives
from recordings import Camera, Samples, labelled_objects, simulated_objects
from samples import sample_image

EPOCHS = 8
BATCH_POSITIVE = 64
POOL = 24000
NEGATIVES = 2 * BATCH_POSITIVE
BATCH = BATCH_POSITIVE + NEGATIVES
# Networks whose mean output teaches the shipped ones: two trainings differ by more than other changes gain.
TEACHERS = 4
# The weights are means over about the last 1 / (1 - this) steps.
MEAN_KEPT = 0.998

IS_OBJECT = np.r_[np.ones(BATCH_POSITIVE), np.zeros(NEGATIVES)].astype(np.float32)[:, None]

Colours = NDArray[np.float64]


def _hardness(network: PatchNetwork, kind: str, colours: NDArray[np.generic], inside: NDArray[np.bool_]) -> Colours:
    """Probability with which each counterexample is drawn: the more it looks like an object, the more often."""
    scores = []
    for start in range(0, len(colours), 2000):
        part = slice(start, start + 2000)
        outputs = network.forward(patches.normalize(kind, colours[part], inside[part]))
        scores.append(logistic(outputs)[:, 0] if kind == "ball" else 1 - softmax(outputs)[:, 0])
    hardness = np.concatenate(scores).astype(float) + 0.01
    return hardness / hardness.sum()


class _MeanWeights:
    """The mean of a network's weights over about the last steps."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._mean = [weight.copy() for weight in network.weights]

    def add(self) -> None:
        """Adds the network's weights."""
        for mean, weight in zip(self._mean, self._network.weights, strict=True):
            mean += (1 - MEAN_KEPT) * (weight - mean)

    def give(self) -> None:
        """Gives the network the mean."""
        self._network.weights = self._mean


def _rate(epoch: int) -> float:
    return float(0.002 * (1 + np.cos(np.pi * epoch / EPOCHS)) + 1e-4)


def _step(network: Network, error: Array, rate: float) -> None:
    network.step(network.backward((error / BATCH).astype(np.float32)), rate)


def train_coarse(examples: Examples, *, steps: int, seed: int) -> CoarseNetwork:
    """The network that ranks places. It meets all of them, not only the hard ones."""
    rng = np.random.default_rng(seed)
    network = CoarseNetwork(3 * len(patches.COARSE) ** 2, seed)
    mean = _MeanWeights(network)
    for epoch in range(EPOCHS):
        for _ in range(steps):
            positive = rng.choice(len(examples.colours), BATCH_POSITIVE, p=examples.shares)
            other = rng.integers(len(examples.other_colours), size=NEGATIVES)
            colours = augment(np.concatenate([examples.colours[positive], examples.other_colours[other]]), MILD, rng)
            known = np.concatenate([examples.inside[positive], examples.other_inside[other]])
            inputs = patches.normalize(examples.kind, patches.coarse(colours), patches.coarse(known))
            _step(network, logistic(network.forward(inputs)) - IS_OBJECT, _rate(epoch))
            mean.add()
    mean.give()
    return network


def train_network(
    examples: Examples,
    size: Size,
    variation: Variation,
    *,
    steps: int,
    seed: int,
    teachers: tuple[PatchNetwork, ...] = (),
) -> PatchNetwork:
    """A network that judges patches: by their labels, or by the mean output of its teachers."""
    rng = np.random.default_rng(seed)
    kind = examples.kind
    network = PatchNetwork(patches.SIDE, examples.outputs, seed, size)
    mean = _MeanWeights(network)
    probabilities = logistic if kind == "ball" else softmax
    for epoch in range(EPOCHS):
        # The hard ones of other counterexamples in each epoch.
        pool = rng.choice(len(examples.other_colours), POOL, p=examples.other_shares)
        hard = np.full(POOL, 1 / POOL)
        if epoch:
            hard = _hardness(network, kind, examples.other_colours[pool], examples.other_inside[pool])
        for _ in range(steps):
            positive = rng.choice(len(examples.colours), BATCH_POSITIVE, p=examples.shares)
            negative = rng.choice(pool, NEGATIVES, p=hard)
            colours = augment(np.concatenate([examples.colours[positive], examples.other_colours[negative]]), variation, rng)
            known = np.concatenate([examples.inside[positive], examples.other_inside[negative]])
            inputs = patches.normalize(kind, colours, known, contrast(BATCH, variation, rng))
            if teachers:
                wanted = probabilities(np.mean([teacher.forward(inputs) for teacher in teachers], 0))
            elif kind == "ball":
                wanted = IS_OBJECT
            else:
                wanted = np.zeros((BATCH, examples.outputs), np.float32)
                wanted[np.arange(BATCH_POSITIVE), examples.labels[positive]] = 1
                wanted[BATCH_POSITIVE:, 0] = 1
            _step(network, probabilities(network.forward(inputs)) - wanted, _rate(epoch))
            mean.add()
    mean.give()
    return network


def train(
    kind: str, samples: list[Samples], simulated: set[str], *, steps: int, seed: int, kept: list[Network] | None = None
) -> list[Network]:
    """The networks of a kind: coarse, screen and judge. Each teacher has composites and random numbers of its own.

    `kept`: the coarse network and the screen, if they are trained already.
    """
    make = ball_examples if kind == "ball" else obstacle_examples
    examples = make(samples, simulated, seed)
    if kept is None:
        screen = train_network(examples, SCREEN, MILD, steps=steps, seed=seed)
        kept = [train_coarse(examples, steps=steps, seed=seed), screen]
        print(f"{kind}: coarse network and screen", flush=True)
    teachers = []
    for number in range(1, 1 + TEACHERS):
        own = make(samples, simulated, seed + number)
        teachers.append(train_network(own, JUDGE, STRONG, steps=steps, seed=seed + number))
        print(f"{kind}: teacher {number} of {TEACHERS}", flush=True)
    judge = train_network(examples, JUDGE, STRONG, steps=steps, seed=seed, teachers=tuple(teachers))
    print(f"{kind}: judge", flush=True)
    return [*kept, judge]


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
    parser.add_argument("--screens", type=Path, metavar="FILE", help="keep the coarse networks and screens of these weights")
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
    kept: dict[str, list[Network]] = {}
    if args.screens:
        earlier = object_networks()
        read_weights(args.screens, earlier)
        kept = {"ball": earlier[:2], "obstacle": earlier[3:5]}
    with ProcessPoolExecutor() as processes:
        trained = [
            processes.submit(train, kind, samples, simulated, steps=args.steps, seed=args.seed, kept=kept.get(kind))
            for kind in ("ball", "obstacle")
        ]
        networks = [network for kind in trained for network in kind.result()]
    write_weights(args.out, networks)
    write_reference(args.out.with_suffix(".reference"), networks)


if __name__ == "__main__":
    main()
