"""Smooth random fields, for skin, hair, cloth and walls."""

from __future__ import annotations

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array


def smooth_field(
    shape: tuple[int, int], grain_px: float | tuple[float, float], rng: np.random.Generator
) -> Float32Array:
    """Return a field (height, width) of mean 0 and deviation 1 whose blobs are about ``grain_px`` in size.

    Args:
        shape: height and width.
        grain_px: distance of the independent values between which the field is interpolated; of rows and
            columns, where two are given.
        rng: draws one number a grain.
    """
    down, across = grain_px if isinstance(grain_px, tuple) else (grain_px, grain_px)
    coarse = (int(np.ceil(shape[0] / down)) + 3, int(np.ceil(shape[1] / across)) + 3)
    values = rng.standard_normal(coarse, dtype=np.float32)
    size = (round(coarse[1] * across), round(coarse[0] * down))
    fine = cv2.resize(values, size, interpolation=cv2.INTER_CUBIC)[: shape[0], : shape[1]]
    fine -= fine.mean()
    field: Float32Array = fine / np.float32(max(float(fine.std()), 1e-6))
    return field


def layered_field(
    shape: tuple[int, int], grains_px: tuple[float, ...], rng: np.random.Generator
) -> Float32Array:
    """Return the mean-free sum of smooth fields of several grains, deviation 1; coarse grains weigh most."""
    total = np.zeros(shape, dtype=np.float32)
    for grain in grains_px:
        total += np.sqrt(np.float32(grain)) * smooth_field(shape, grain, rng)
    scaled: Float32Array = total / np.float32(max(float(total.std()), 1e-6))
    return scaled
