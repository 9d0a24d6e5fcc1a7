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
"""Output channels, multiples of 8, and kernel sizes of the convolutions."""
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
def _convolved(image: Float32Array, weights: Float32Array, bias: Float32Array) -> Float32Array:
    """Return the convolution with stride 2 of (H, W, C), padded with zeros, cut off below zero.

    Eight output channels at a time are summed in a vector register. The order of each sum is fixed.
    """
    height, width, channels = image.shape
    size, count = weights.shape[0], weights.shape[3]
    margin, zero = size // 2, np.float32(0.0)
    out = np.empty(((height + 1) // 2, (width + 1) // 2, count), np.float32)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            for k in range(0, count, 8):
                b, o = bias[k : k + 8], out[y, x, k : k + 8]
                s0, s1, s2, s3, s4, s5, s6, s7 = b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]
                for i in range(max(0, margin - 2 * y), min(size, height + margin - 2 * y)):
                    for j in range(max(0, margin - 2 * x), min(size, width + margin - 2 * x)):
                        for c in range(channels):
                            value = image[2 * y + i - margin, 2 * x + j - margin, c]
                            if value != 0.0:
                                w = weights[i, j, c, k : k + 8]
                                s0, s1 = s0 + value * w[0], s1 + value * w[1]
                                s2, s3 = s2 + value * w[2], s3 + value * w[3]
                                s4, s5 = s4 + value * w[4], s5 + value * w[5]
                                s6, s7 = s6 + value * w[6], s7 + value * w[7]
                o[0], o[1], o[2], o[3] = max(s0, zero), max(s1, zero), max(s2, zero), max(s3, zero)
                o[4], o[5], o[6], o[7] = max(s4, zero), max(s5, zero), max(s6, zero), max(s7, zero)
    return out


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
        convolutions: kernels (size, size, inputs, outputs) and biases.
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
        layer = ((grey - grey.mean()) / (grey.std() + np.float32(LEAST_CONTRAST)))[..., None]
        for weights, bias in self.convolutions:
            layer = _convolved(np.ascontiguousarray(layer), weights, bias)
        (first, last) = self.full
        hidden = np.maximum(_connected(layer.ravel(), *first), np.float32(0.0))
        return _connected(hidden, *last).astype(np.float64)


@lru_cache(maxsize=1)
def shipped_networks() -> Mapping[str, Network]:
    """Return the shipped networks by region."""
    arrays = read_npz(read_input(SHIPPED, limits.MODEL_BYTES))

    def pair(name: str) -> tuple[Float32Array, Float32Array]:
        weights, bias = (arrays[f"{name}.{part}"].astype(np.float32) for part in ("weights", "bias"))
        return np.ascontiguousarray(weights), bias

    return {
        name: Network(
            tuple(pair(f"{name}.convolution{layer}") for layer in range(len(CHANNELS))),
            (pair(f"{name}.full0"), pair(f"{name}.full1")),
            arrays[f"{name}.middle"],
            arrays[f"{name}.spread"],
        )
        for name in (MOUTH_NETWORK, EYE_NETWORK, GAZE_NETWORK)
    }
