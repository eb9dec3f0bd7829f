r"""Trains the networks that judge balls, robots and people by their pixels; writes objects.weights.

`python py/training/prepare_recordings.py --mirrorball EXE --labelled REAL --out DIR`
`OPENBLAS_NUM_THREADS=1 python py/training/train_objects.py --prepared DIR --earlier W --out W \
    --train ball-screen ball-judge obstacle-judge`

with W = crates/vision/src/objects/objects.weights gives the weights of the repository, whose other networks are of an earlier
training (docs/experiments.md). Without `--train` all are trained. It takes half an hour of two cores.
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
from prepare_recordings import SETS, WITH_PEOPLE, drives
from recordings import Camera, Samples, labelled_objects, simulated_objects
from samples import sample_image

KINDS = ("ball", "obstacle")
PARTS = ("coarse", "screen", "judge")
# In the order of objects.weights.
NETWORKS = [f"{kind}-{part}" for kind in KINDS for part in PARTS]
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
    kind: str, parts: list[str], samples: list[Samples], simulated: set[str], *, steps: int, seed: int
) -> dict[str, Network]:
    """Those networks of a kind that `parts` names. Each teacher has composites and random numbers of its own."""
    make = ball_examples if kind == "ball" else obstacle_examples
    examples = make(samples, simulated, seed)
    trained: dict[str, Network] = {}
    if "coarse" in parts:
        trained["coarse"] = train_coarse(examples, steps=steps, seed=seed)
    if "screen" in parts:
        trained["screen"] = train_network(examples, SCREEN, MILD, steps=steps, seed=seed)
        print(f"{kind}: screen", flush=True)
    if "judge" in parts:
        teachers = []
        for number in range(1, 1 + TEACHERS):
            own = make(samples, simulated, seed + number)
            teachers.append(train_network(own, JUDGE, STRONG, steps=steps, seed=seed + number))
            print(f"{kind}: teacher {number} of {TEACHERS}", flush=True)
        trained["judge"] = train_network(examples, JUDGE, STRONG, steps=steps, seed=seed, teachers=tuple(teachers))
        print(f"{kind}: judge", flush=True)
    return trained


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
    parser.add_argument(
        "--with-people", action="append", default=[], metavar="DIR", help="simulated; balls alone are learnt from it"
    )
    parser.add_argument("--steps", type=int, default=400, help="steps of each of the eight epochs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--train", nargs="+", choices=NETWORKS, default=NETWORKS, metavar="NETWORK", help=", ".join(NETWORKS))
    parser.add_argument("--earlier", type=Path, metavar="FILE", help="weights of the networks that are not trained")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    if set(args.train) != set(NETWORKS) and not args.earlier:
        parser.error("--train needs --earlier, which holds the other networks")
    if args.prepared:
        names = [name for name in ("labelled_Y3", "labelled_Y1") if name != args.leave_out]
        args.labelled += [str(args.prepared / name) for name in names]
        args.simulated += [str(args.prepared / name) for name in drives(SETS)]
        args.with_people += [str(args.prepared / name) for name in drives(WITH_PEOPLE)]
    samples = []
    recordings = [(labelled_camera(text), labelled_objects, True) for text in args.labelled]
    recordings += [(Camera(Path(text)), simulated_objects, True) for text in args.simulated]
    recordings += [(Camera(Path(text)), simulated_objects, False) for text in args.with_people]
    for camera, objects_of, has_obstacles in recordings:
        objects = objects_of(camera)
        # Its own numbers, so that leaving a recording out changes no other's patches.
        rng = np.random.default_rng(args.seed)
        for stamp, file in camera.frames:
            balls, obstacles = objects.get(stamp, ([], []))
            samples.append(sample_image(camera, file, balls, obstacles if has_obstacles else None, rng))
        print(f"{camera.folder}: {len(camera.frames)} pictures", flush=True)
    simulated = {Path(text).name for text in args.simulated + args.with_people}
    networks = object_networks()
    if args.earlier:
        read_weights(args.earlier, networks)
    with ProcessPoolExecutor() as processes:
        training = {}
        for kind in KINDS:
            parts = [part for part in PARTS if f"{kind}-{part}" in args.train]
            if parts:
                training[kind] = processes.submit(train, kind, parts, samples, simulated, steps=args.steps, seed=args.seed)
        for kind, trained in training.items():
            for part, network in trained.result().items():
                networks[NETWORKS.index(f"{kind}-{part}")] = network
    write_weights(args.out, networks)
    write_reference(args.out.with_suffix(".reference"), networks)


if __name__ == "__main__":
    main()
