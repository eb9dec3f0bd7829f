"""What the networks of a kind learn from: patches of objects and of other places, and how often each is shown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from composites import composite_balls, composite_no_obstacles, composite_obstacles, composite_others
from numpy.typing import NDArray
from recordings import PERSON, Samples

# Share of painted and pasted obstacles among those of a batch.
PAINTED = 0.25

Colours = NDArray[np.float64]


@dataclass(frozen=True)
class Examples:
    """Patches (n, side, side, 3) with the pixels inside the image, the objects' classes, and shares that sum to one."""

    kind: str
    colours: NDArray[np.generic]
    inside: NDArray[np.bool_]
    labels: NDArray[np.int_]
    shares: Colours
    other_colours: NDArray[np.generic]
    other_inside: NDArray[np.bool_]
    other_shares: Colours

    @property
    def outputs(self) -> int:
        """Outputs of a network: log odds of a ball, or nothing, robot, person."""
        return 1 if self.kind == "ball" else 3


def balanced(groups: list[Colours]) -> Colours:
    """Shares of all entries' weights such that each group has the same total."""
    return np.concatenate([group / max(group.sum(), 1e-9) / len(groups) for group in groups])


def _even(parts: list[int], is_labelled: list[bool]) -> Colours:
    """Shares of pictures' counterexamples: photographs and simulated images have half each."""
    labelled = np.repeat(is_labelled, parts)
    groups = [part.astype(float) for part in (labelled, ~labelled) if part.any()]
    return np.asarray(sum(group / group.sum() for group in groups) / len(groups))


def ball_examples(samples: list[Samples], simulated: set[str], seed: int) -> Examples:
    """Examples of balls; photographs, simulated images and composites weigh the same."""
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
    return Examples("ball", colours, everywhere[0], labels, weights, others, everywhere[1], share)


def obstacle_examples(samples: list[Samples], simulated: set[str], seed: int) -> Examples:
    """Examples of robots and people; each object of a photograph weighs the same, and all simulated ones half as much."""
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
    others = [len(sample.obstacle_negatives) for sample in samples]
    return Examples(
        "obstacle",
        np.concatenate([np.array(colours), painted]),
        np.concatenate([np.array(inside), everywhere[0]]),
        np.concatenate([np.array(labels), kinds]),
        np.concatenate([(1 - PAINTED) * share / share.sum(), np.full(len(painted), PAINTED / len(painted))]),
        np.concatenate([negatives, wrong]),
        np.concatenate([known, everywhere[1]]),
        _even([*others, len(wrong)], [*(sample.camera not in simulated for sample in samples), False]),
    )
