"""Small networks with their gradients, in numpy: the same layers as crates/vision/src/objects/network.rs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

COARSE_UNITS = 8
# Channels of both convolutions and units of the dense layer, of the network that screens patches and of the one that judges.
Size = tuple[int, int, int]
SCREEN: Size = (8, 16, 24)
JUDGE: Size = (16, 32, 32)
CHANNELS = 3
PATCH_SIDE = 12
COARSE_SIDE = 6


class Network(ABC):
    """Weights and their Adam state."""

    @abstractmethod
    def forward(self, patches: Array) -> Array:
        """Outputs before the logistic function."""

    @abstractmethod
    def backward(self, error: Array) -> list[Array]:
        """Gradients of the weights for the last inputs."""

    def __init__(self, shapes: list[tuple[int, ...]], seed: int) -> None:
        rng = np.random.default_rng(seed)
        last = max(index for index, shape in enumerate(shapes) if len(shape) == 2)
        self.weights: list[Array] = []
        for index, shape in enumerate(shapes):
            if len(shape) == 1:
                self.weights.append(np.zeros(shape, np.float32))
            else:
                scale = np.sqrt(2 / shape[0]) * (0.5 if index == last else 1.0)
                self.weights.append((rng.normal(size=shape) * scale).astype(np.float32))
        self._mean = [np.zeros_like(weight) for weight in self.weights]
        self._square = [np.zeros_like(weight) for weight in self.weights]
        self._steps = 0

    def step(self, gradients: list[Array], rate: float, decay: float = 1e-4) -> None:
        """One step of Adam with weight decay."""
        self._steps += 1
        for index, (weight, gradient) in enumerate(zip(self.weights, gradients, strict=True)):
            full = gradient + decay * weight if weight.ndim > 1 else gradient
            self._mean[index] += 0.1 * (full - self._mean[index])
            self._square[index] += 0.001 * (full * full - self._square[index])
            mean = self._mean[index] / (1 - 0.9**self._steps)
            square = self._square[index] / (1 - 0.999**self._steps)
            weight -= (rate * mean / (np.sqrt(square) + 1e-7)).astype(np.float32)


class CoarseNetwork(Network):
    """One hidden layer."""

    def __init__(self, inputs: int, seed: int) -> None:
        super().__init__([(inputs, COARSE_UNITS), (COARSE_UNITS,), (COARSE_UNITS, 1), (1,)], seed)

    def forward(self, patches: Array) -> Array:
        """Outputs before the logistic function."""
        self._inputs = patches.reshape(len(patches), -1)
        self._hidden = np.maximum(self._inputs @ self.weights[0] + self.weights[1], 0)
        return self._hidden @ self.weights[2] + self.weights[3]

    def backward(self, error: Array) -> list[Array]:
        """Gradients of the weights for the last inputs."""
        hidden = (error @ self.weights[2].T) * (self._hidden > 0)
        return [self._inputs.T @ hidden, hidden.sum(0), self._hidden.T @ error, error.sum(0)]


def _kernel_indices(channels: int, side: int) -> NDArray[np.int_]:
    """Index into a padded image of each input of each place of a 3 × 3 convolution with stride 2."""
    places = 2 * np.arange(side // 2)
    kernel = np.arange(3)
    plane, width = (side + 2) ** 2, side + 2
    index = (
        np.arange(channels)[None, None, :, None, None] * plane
        + (places[:, None, None, None, None] + kernel[None, None, None, :, None]) * width
        + places[None, :, None, None, None]
        + kernel[None, None, None, None, :]
    )
    return index.reshape(len(places) ** 2, channels * 9)


def _padded(image: Array) -> Array:
    return np.pad(image, ((0, 0), (0, 0), (1, 1), (1, 1))).reshape(len(image), -1)


class PatchNetwork(Network):
    """Two convolutions and two dense layers."""

    def __init__(self, side: int, outputs: int, seed: int, size: Size) -> None:
        self._channels1, self._channels2, _ = size
        self._side1, self._side2 = side // 2, side // 4
        flat = self._side2**2 * self._channels2
        shapes: list[tuple[int, ...]] = [
            (CHANNELS * 9, size[0]), (size[0],), (size[0] * 9, size[1]), (size[1],),
            (flat, size[2]), (size[2],), (size[2], outputs), (outputs,),
        ]  # fmt: skip
        super().__init__(shapes, seed)
        self._index1 = _kernel_indices(CHANNELS, side)
        self._index2 = _kernel_indices(self._channels1, self._side1)

    def forward(self, patches: Array) -> Array:
        """Outputs before the logistic function."""
        weights, count = self.weights, len(patches)
        self._in1 = _padded(patches)[:, self._index1]
        self._out1 = np.maximum(self._in1 @ weights[0] + weights[1], 0)
        image = self._out1.transpose(0, 2, 1).reshape(count, self._channels1, self._side1, self._side1)
        self._in2 = _padded(image)[:, self._index2]
        self._out2 = np.maximum(self._in2 @ weights[2] + weights[3], 0)
        self._flat = self._out2.reshape(count, -1)
        self._dense = np.maximum(self._flat @ weights[4] + weights[5], 0)
        return self._dense @ weights[6] + weights[7]

    def backward(self, error: Array) -> list[Array]:
        """Gradients of the weights for the last inputs."""
        weights, count = self.weights, len(error)
        dense = (error @ weights[6].T) * (self._dense > 0)
        out2 = (dense @ weights[4].T).reshape(self._out2.shape) * (self._out2 > 0)
        in2 = out2 @ weights[2].T
        padded = np.zeros((count, self._channels1 * (self._side1 + 2) ** 2), np.float32)
        for place, index in enumerate(self._index2):
            padded[:, index] += in2[:, place]
        image = padded.reshape(count, self._channels1, self._side1 + 2, self._side1 + 2)[:, :, 1:-1, 1:-1]
        out1 = image.reshape(count, self._channels1, -1).transpose(0, 2, 1) * (self._out1 > 0)
        return [
            self._in1.reshape(-1, CHANNELS * 9).T @ out1.reshape(-1, self._channels1), out1.sum((0, 1)),
            self._in2.reshape(-1, self._channels1 * 9).T @ out2.reshape(-1, self._channels2), out2.sum((0, 1)),
            self._flat.T @ dense, dense.sum(0), self._dense.T @ error, error.sum(0),
        ]  # fmt: skip


def logistic(outputs: Array) -> Array:
    """Probabilities of log odds."""
    return 1 / (1 + np.exp(-np.clip(outputs, -30, 30)))


def softmax(outputs: Array) -> Array:
    """Probabilities of exclusive classes."""
    shares = np.exp(outputs - outputs.max(1, keepdims=True))
    return shares / shares.sum(1, keepdims=True)


def write_weights(path: Path, networks: list[Network]) -> None:
    """Writes all weights as little-endian float32, in the order in which the crate reads them."""
    path.write_bytes(b"".join(weight.astype("<f4").tobytes() for network in networks for weight in network.weights))


def read_weights(path: Path, networks: list[Network]) -> None:
    """Reads all weights as [`write_weights`] writes them; an error if the file is of other networks."""
    values = np.frombuffer(path.read_bytes(), "<f4")
    count = sum(weight.size for network in networks for weight in network.weights)
    if len(values) != count:
        raise ValueError(f"{path}: {len(values)} weights (expected {count})")
    for network in networks:
        for index, weight in enumerate(network.weights):
            network.weights[index] = values[: weight.size].reshape(weight.shape).astype(np.float32)
            values = values[weight.size :]


def object_networks() -> list[Network]:
    """Untrained networks of the shape and order of objects.weights: coarse, screen and judge, of balls and of obstacles."""
    coarse, side = 3 * COARSE_SIDE**2, PATCH_SIDE
    return [
        network
        for outputs in (1, 3)
        for network in (
            CoarseNetwork(coarse, 0),
            PatchNetwork(side, outputs, 0, SCREEN),
            PatchNetwork(side, outputs, 0, JUDGE),
        )
    ]


def reference_outputs(networks: list[Network]) -> list[float]:
    """Outputs for one artificial input, against which the crate's own inference is tested."""
    outputs: list[float] = []
    for network in networks:
        side = COARSE_SIDE if isinstance(network, CoarseNetwork) else PATCH_SIDE
        numbers = np.arange(CHANNELS * side**2)
        patch = (numbers * 37 % 101 / 50 - 1).astype(np.float32).reshape(1, CHANNELS, side, side)
        outputs += [float(value) for value in network.forward(patch)[0]]
    return outputs


def write_reference(path: Path, networks: list[Network]) -> None:
    """Writes the reference outputs, one per line."""
    path.write_text("".join(f"{value:.6f}\n" for value in reference_outputs(networks)))
