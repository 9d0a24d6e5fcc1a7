"""Small convolutional networks that locate points in crops of a face **[ours]**.

A crop of mean 0 and standard deviation 1 passes convolutions with stride 2 and two full layers. The outputs
are, for each point, crop pixels, mm in front of the region's plane, and the log of a standard deviation; or
the angles of a gaze with the log of a deviation.
``scripts/build face-dense`` trains the weights on rendered faces.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.compiled import kernel
from posetrack_cli.files import read_input
from posetrack_cli.npz import read_npz

CHANNELS, KERNELS = (16, 24, 32, 32), (5, 3, 3, 3)
"""Output channels and kernel sizes of the convolutions."""
HIDDEN = 96
"""Size of the first full layer."""
POSITION_SCALE = 10.0
"""Crop pixels, and mm of depth, per unit of the outputs."""
LEAST_SD = 0.02
"""Smallest standard deviation, in the same unit."""
LEAST_CONTRAST = 4.0
"""Grey levels added to a crop's standard deviation, so that noise is not amplified."""
SHIPPED = Path(__file__).with_name("networks.npz")
MOUTH_NETWORK, EYE_NETWORK, GAZE_NETWORK = "mouth", "eye", "gaze"


@kernel
def _patches(image: Float32Array, size: int, count: int) -> Float32Array:
    """Return what each output of a convolution with stride 2 sees of (C, H, W), padded with zeros.

    Returns:
        (count, M): row, column and channel of the kernel, then zeros; outputs, row by row.
    """
    channels, height, width = image.shape
    rows, columns, margin = (height + 1) // 2, (width + 1) // 2, size // 2
    padded = np.zeros((channels, 2 * rows + size, 2 * columns + size + 1), np.float32)
    padded[:, margin : margin + height, margin : margin + width] = image
    seen = np.zeros((count, rows * columns), np.float32)
    for n in range(size * size * channels):
        i, j, c = n // (size * channels), n // channels % size, n % channels
        for y in range(rows):
            part, line = seen[n, y * columns : (y + 1) * columns], padded[c, 2 * y + i, j::2]
            for x in range(columns):
                part[x] = line[x]
    return seen


@kernel
def _convolved(image: Float32Array, size: int, weights: Float32Array, bias: Float32Array) -> Float32Array:
    """Return the convolution with stride 2 of (C, H, W), cut off below zero.

    The inner loop runs over the outputs of a channel, so that it is vectorised and the order of each sum is
    fixed.

    Args:
        image: (C, H, W).
        size: of the kernel.
        weights: (outputs, N), see ``_in_fours``.
        bias: (outputs,).
    """
    height, width = image.shape[1:]
    seen = _patches(image, size, weights.shape[1])
    out = np.empty((bias.size, seen.shape[1]), np.float32)
    for k in range(bias.size):
        sums, own = out[k], weights[k]
        sums[:] = bias[k]
        for n in range(0, own.size, 4):
            w0, w1, w2, w3 = own[n], own[n + 1], own[n + 2], own[n + 3]
            s0, s1, s2, s3 = seen[n], seen[n + 1], seen[n + 2], seen[n + 3]
            for m in range(sums.size):
                sums[m] = sums[m] + s0[m] * w0 + s1[m] * w1 + s2[m] * w2 + s3[m] * w3
        for m in range(sums.size):
            sums[m] = max(sums[m], np.float32(0.0))
    return out.reshape((bias.size, (height + 1) // 2, (width + 1) // 2))


@kernel
def _connected(values: Float32Array, weights: Float32Array, bias: Float32Array) -> Float32Array:
    """Return bias + values . weights, summed in a fixed order."""
    total = bias.copy()
    for i in range(values.size):
        if values[i] != 0.0:
            row = weights[i]
            for k in range(total.size):
                total[k] += values[i] * row[k]
    return total


@dataclass(frozen=True, eq=False)
class Located:
    """Points located in a crop.

    Attributes:
        pixels: (P, 2) crop pixels.
        depths: (P,) mm in front of the region's plane.
        deviations: (P,) standard deviation of each coordinate, crop pixels.
    """

    pixels: FloatArray
    depths: FloatArray
    deviations: FloatArray


@dataclass(frozen=True, eq=False)
class Network:
    """Network of one kind of region.

    Attributes:
        convolutions: kernels, see ``_in_fours``, and biases.
        full: matrices (inputs, outputs) and biases; inputs of the first are in the order y, x, channel.
        middle: (P, 3) mean places.
        spread: (P,) factor from stated to actual deviations; (1,) for the network of gazes.
    """

    convolutions: tuple[tuple[Float32Array, Float32Array], ...]
    full: tuple[tuple[Float32Array, Float32Array], ...]
    middle: FloatArray
    spread: FloatArray

    def locate(self, crop: ImageArray) -> Located:
        """Locate the points in a crop."""
        out = self._outputs(crop)
        count = len(self.middle)
        places = out[: 3 * count].reshape(count, 3) * POSITION_SCALE + self.middle
        deviations = (np.exp(out[3 * count :]) + LEAST_SD) * POSITION_SCALE * self.spread
        return Located(places[:, :2], places[:, 2], deviations)

    def gaze(self, crop: ImageArray) -> FloatArray:
        """Return the gaze in an eye's crop: angles to the side of its columns and up, and deviation, rad."""
        side, up, log_spread = self._outputs(crop)
        return np.array([side, up, (np.exp(log_spread) + LEAST_SD) * self.spread[0]])

    def _outputs(self, crop: ImageArray) -> FloatArray:
        grey = crop.astype(np.float32)
        layer = ((grey - grey.mean()) / (grey.std() + np.float32(LEAST_CONTRAST)))[None]
        for size, (weights, bias) in zip(KERNELS, self.convolutions, strict=True):
            layer = _convolved(layer, size, weights, bias)
        (first, last) = self.full
        hidden = np.maximum(_connected(layer.transpose(1, 2, 0).ravel(), *first), np.float32(0.0))
        return _connected(hidden, *last).astype(np.float64)


def _in_fours(kernels: Float32Array, bias: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return kernels (size, size, inputs, outputs) as (outputs, N), with zeros up to a multiple of 4."""
    flat = kernels.reshape(-1, len(bias)).T
    return np.pad(flat, ((0, 0), (0, -flat.shape[1] % 4))), bias


@lru_cache(maxsize=1)
def shipped_networks() -> Mapping[str, Network]:
    """Return the shipped networks by region."""
    arrays = read_npz(read_input(SHIPPED, limits.MODEL_BYTES))

    def pair(name: str) -> tuple[Float32Array, Float32Array]:
        weights, bias = (arrays[f"{name}.{part}"].astype(np.float32) for part in ("weights", "bias"))
        return np.ascontiguousarray(weights), bias

    return {
        name: Network(
            tuple(_in_fours(*pair(f"{name}.convolution{layer}")) for layer in range(len(CHANNELS))),
            (pair(f"{name}.full0"), pair(f"{name}.full1")),
            arrays[f"{name}.middle"],
            arrays[f"{name}.spread"],
        )
        for name in (MOUTH_NETWORK, EYE_NETWORK, GAZE_NETWORK)
    }
