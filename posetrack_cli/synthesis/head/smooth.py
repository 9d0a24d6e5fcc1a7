"""Smooth steps, curves and fields: what a head, its motion and its light are made of."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray


def smooth_step(s: FloatArray) -> FloatArray:
    """Return 3 s^2 - 2 s^3 of s (...) clipped to [0, 1]: from 0 to 1, level at both ends."""
    t = np.clip(s, 0.0, 1.0)
    step: FloatArray = t * t * (3.0 - 2.0 * t)
    return step


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


class Displacements:
    """The field d(x) = sum_i w_i k(|x - x_i|) that takes given values at given places, and fades elsewhere.

    k(r) = (1 + s) exp(-s), s = sqrt(3) r / reach: Matern's kernel of smoothness 3/2. It overshoots less
    than a Gaussian where two places lie close together.

    Args:
        places: (n, D) all different.
        values: (n, C) of the field there.
        reach: length over which it fades.
    """

    def __init__(self, places: FloatArray, values: FloatArray, reach: float) -> None:
        self._places, self._reach = places, reach
        self._weights = np.linalg.solve(self._kernel(places), values)

    def __call__(self, at: FloatArray) -> FloatArray:
        """The field (..., C) at places (..., D)."""
        flat = at.reshape(-1, at.shape[-1])
        values: FloatArray = self._kernel(flat) @ self._weights
        return values.reshape(*at.shape[:-1], -1)

    def _kernel(self, at: FloatArray) -> FloatArray:
        distance = np.linalg.norm(at[:, None, :] - self._places[None, :, :], axis=-1)
        s = np.sqrt(3.0) / self._reach * distance
        kernel: FloatArray = (1.0 + s) * np.exp(-s)
        return kernel


MINIMUM_JERK_PEAK = 1.875
"""Greatest speed of a minimum-jerk move of length 1 in time 1."""


def minimum_jerk(s: FloatArray) -> FloatArray:
    """Return 10 s^3 - 15 s^4 + 6 s^5 of s (...) clipped to [0, 1]: from 0 to 1, at rest at both ends."""
    s = np.clip(s, 0.0, 1.0)
    # Hands have the same polynomial, whose cube is s s s: it differs in the last bit in one case of four, and
    # so would the bytes of recordings that are made again of the same seed.
    step: FloatArray = s**3 * (10.0 + s * (6.0 * s - 15.0))
    return step


def pulse(times: FloatArray, start: float, rise: float, hold: float, fall: float) -> FloatArray:
    """Return a pulse (T,) of height 1 that begins at ``start``: it rises, is held and falls, s each."""
    down = minimum_jerk((times - start - rise - hold) / fall)
    return minimum_jerk((times - start) / rise) - down


@dataclass(frozen=True, eq=False)
class Sway:
    """D sums of sines: x_d(t) = sum_k a_dk sin(2 pi f_dk t + p_dk).

    Attributes:
        amplitude, frequency, phase: (D, n), the frequency in Hz.
    """

    amplitude: FloatArray
    frequency: FloatArray
    phase: FloatArray

    def __call__(self, times: FloatArray) -> FloatArray:
        """The values (T, D) at times (T,), s."""
        angle = 2.0 * np.pi * self.frequency * times[:, None, None] + self.phase
        values: FloatArray = np.sum(self.amplitude * np.sin(angle), axis=-1)
        return values


def random_sway(
    most: FloatArray, frequencies: tuple[float, float], rng: np.random.Generator, sines: int = 2
) -> Sway:
    """Draw sums of sines that stay within ``most`` (D,), with frequencies from an interval, Hz."""
    size = (len(most), sines)
    share = rng.uniform(0.5, 1.0, size)
    share /= share.sum(axis=1, keepdims=True)
    return Sway(most[:, None] * share, rng.uniform(*frequencies, size), rng.uniform(0.0, 2.0 * np.pi, size))
