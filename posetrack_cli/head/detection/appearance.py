"""Appearance of the ten points of an upright face, learned from many faces **[ours]**.

The descriptor at a place consists of gradient histograms: orientations in ``BINS`` bins, weighted by their
strength relative to the surroundings, blurred, square-rooted and sampled at ``TAPS`` x ``TAPS`` places
``SPACING`` pixels apart. The log-odds of a histogram h at a point against its neighbourhood are linear in h,

    log p(h | point) / p(h | near it) = w . h + b,    w = C^-1 (mean at the point - mean near it)

(linear discriminant analysis of gradient histograms: Hariharan, Malik and Ramanan 2012). ``scripts/build
face-features`` estimates the parameters; they are means and covariances over people and contain no image of a
person.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.compiled import kernel
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.files import read_input
from posetrack_cli.head.face.points import MIRRORED, POINT_COUNT
from posetrack_cli.npz import Arrays, read_npz

BINS, TAPS, SPACING = 8, 7, 4
"""Gradient orientations; sampling places per side; pixels between them."""
SMOOTHING, SPREAD, SURROUNDINGS = 0.8, 1.6, 10.0
"""Blurs, pixels: of the image, of the histograms, and of the surroundings that normalise gradients."""
DARKEST, FULL = 16.0, 100.0
"""Grey levels g are mapped to ``FULL`` log(g + ``DARKEST``), which preserves gradients in shadows."""
LEAST_GRADIENT = 1.5
"""Gradient noise per pixel, on that scale."""
SHIPPED = Path(__file__).with_name("appearance.npz")
RIGHT_SIDE = tuple(k for k, other in enumerate(MIRRORED) if k < other)
"""Points with stored parameters; those of the left side are mirror images."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """Appearance of the points, and variation of face shapes.

    Attributes:
        weights: (K, BINS, TAPS, TAPS) w.
        constants: (K,) b.
        shape_modes: (M, K, 3) mm, modes of one standard deviation in which neutral faces differ from
            ``FEATURES`` and deform.
    """

    weights: Float32Array
    constants: FloatArray
    shape_modes: FloatArray

    def log_odds(self, histograms: Float32Array, k: int, corner: tuple[int, int], side: int) -> Float32Array:
        """Return (side, side) log-odds of point k at the pixels from a corner (x, y) on."""
        scores = np.empty((side, side), dtype=np.float32)
        _correlate(histograms, self.weights[k], corner[0], corner[1], scores)
        return scores + np.float32(self.constants[k])


def histograms(grey: ImageArray) -> Float32Array:
    """Return the gradient histograms (BINS, height, width) of an image."""
    lightness = np.float32(FULL) * np.log(grey.astype(np.float32) + np.float32(DARKEST))
    smooth = cv2.GaussianBlur(lightness, (0, 0), SMOOTHING)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1)
    length, turn = cv2.cartToPolar(across, down)
    around = np.sqrt(cv2.GaussianBlur(length * length, (0, 0), SURROUNDINGS)) + np.float32(LEAST_GRADIENT)
    strength, place = length / around, turn * np.float32(BINS / (2.0 * np.pi))
    found = np.empty((BINS, *grey.shape), dtype=np.float32)
    for number in range(BINS):
        # linear interpolation between neighbouring orientations, cyclic
        away = np.abs(place - np.float32(number))
        share = np.maximum(1.0 - np.minimum(away, BINS - away), 0.0)
        found[number] = cv2.GaussianBlur(share * strength, (0, 0), SPREAD)
    return np.sqrt(np.maximum(found, 0.0))


@kernel
def _correlate(
    histograms: Float32Array, weights: Float32Array, left: int, top: int, scores: Float32Array
) -> None:
    """Write w . h at every pixel of a window, with replicated image borders."""
    bins, height, width = histograms.shape
    taps = weights.shape[1]
    scores[:] = 0.0
    for y in range(scores.shape[0]):
        for x in range(scores.shape[1]):
            total = 0.0
            for i in range(taps):
                row = min(max(top + y + (i - taps // 2) * SPACING, 0), height - 1)
                for j in range(taps):
                    column = min(max(left + x + (j - taps // 2) * SPACING, 0), width - 1)
                    for number in range(bins):
                        total += weights[number, i, j] * histograms[number, row, column]
            scores[y, x] = total


@lru_cache(maxsize=4)
def load_appearance(path: Path = SHIPPED) -> Appearance:
    """Read an appearance model from ``scripts/build face-features``.

    Raises:
        UsageError: the file does not exist.
        ResultError: not an appearance model, or damaged.
    """
    if not path.is_file():
        raise UsageError("no such appearance model", where=path)
    try:
        return _checked(read_npz(read_input(path, limits.MODEL_BYTES)))
    except (OSError, ValueError, KeyError) as error:
        raise ResultError(
            "not an appearance model",
            where=path,
            found=error,
            expected="a file written by scripts/build face-features",
        ) from error


def _checked(arrays: Arrays) -> Appearance:
    half, count = arrays["weights"], len(RIGHT_SIDE)
    wanted = {"weights": (count, BINS, TAPS, TAPS), "constants": (count,)}
    for name, shape in wanted.items():
        if arrays[name].shape != shape:
            raise ValueError(f"array '{name}' has shape {arrays[name].shape}, expected {shape}")
    modes = arrays["shape_modes"]
    if modes.ndim != 3 or modes.shape[1:] != (POINT_COUNT, 3) or len(modes) > limits.FACE_PARAMETERS:
        raise ValueError(f"array 'shape_modes' has shape {modes.shape}")
    if not all(np.isfinite(array).all() for array in (half, arrays["constants"], modes)):
        raise ValueError("non-finite values")
    weights = np.empty((POINT_COUNT, *half.shape[1:]), dtype=np.float32)
    constants = np.empty(POINT_COUNT)
    for one, constant, k in zip(half, arrays["constants"], RIGHT_SIDE, strict=True):
        weights[k], weights[MIRRORED[k]] = one, mirrored_weights(one)
        constants[k] = constants[MIRRORED[k]] = constant
    return Appearance(weights, constants, modes.astype(np.float64))


def mirrored_weights(weights: Float32Array) -> Float32Array:
    """Return mirrored weights (BINS, TAPS, TAPS): an orientation a becomes pi - a."""
    turned = (BINS // 2 - np.arange(BINS)) % BINS  # bins are centred at multiples of 2 pi / BINS
    return np.ascontiguousarray(weights[turned][:, :, ::-1])
