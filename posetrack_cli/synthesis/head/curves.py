"""Smooth functions of time that motion, expressions and light are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray

MINIMUM_JERK_PEAK = 1.875
"""Greatest speed of a minimum-jerk move of length 1 in time 1."""


def minimum_jerk(s: FloatArray) -> FloatArray:
    """Return 10 s^3 - 15 s^4 + 6 s^5 of s (...) clipped to [0, 1]: from 0 to 1, at rest at both ends."""
    s = np.clip(s, 0.0, 1.0)
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
