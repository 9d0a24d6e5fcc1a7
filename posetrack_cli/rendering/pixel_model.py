"""How a reading of depth comes about where a surface is rendered: visible, occluded or an outlier.

The model of a pixel is that of Wüthrich et al. 2013 (dbot): Gaussian noise about the surface, an
exponential density before it for what hides it, and a small uniform one for everything else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray

_LOGISTIC_OF_NORMAL = 1.702
"""1 / (1 + exp(-1.702 t)) is the normal distribution function to .01 (Camilli 1994)."""


@dataclass(frozen=True)
class PixelMixture:
    """The density of a reading y where the surface is at depth d, and its misfit.

        p(y | d) = v N(y; d, s(d)^2) + o l exp(-l y) [y <= d] / (1 - exp(-l d)) + u / range

    with v = 1 - o - u. The misfit is rho(y, d) = log p(d | d) - log p(y | d): 0 for a perfect reading.
    It grows like a square, bends at some 3 s and goes to ``unexplained(d)`` behind the surface and less
    in front of it.

    A reading known to be of something else (the image's negative numbers) is there whether or not the
    surface is behind it: y = min(surface, other things), so where it lies in front it says nothing about
    the surface and costs nothing. Where it lies behind, one would look through the surface: an outlier.
    With F the probability that noise of s(d) has not exchanged the two,

        rho(-y, d) = -log(F((d - y) / s) + (1 - F) exp(-unexplained(d)))

    Attributes:
        near_sd_mm, sd_mm_per_m2: s(d) = near_sd_mm + sd_mm_per_m2 d^2, d in metres.
        occluded: o, the share of readings that are of unknown things in front.
        half_life_mm: ln 2 / l, over which such things get half as frequent.
        outlier: u, the share of readings that nothing explains.
        range_mm: of the sensor, over which they are spread.
    """

    near_sd_mm: float = 3.0
    sd_mm_per_m2: float = 1.42
    occluded: float = 0.1
    half_life_mm: float = 1000.0
    outlier: float = 0.01
    range_mm: float = 4500.0

    @property
    def uniforms(self) -> dict[str, float]:
        """The numbers that ``tile_sums.comp`` computes misfits of, by name."""
        peak = np.sqrt(2.0 * np.pi) / (1.0 - self.occluded - self.outlier)
        rate = np.log(2.0) / self.half_life_mm
        return {
            "near_sd": self.near_sd_mm,
            "sd_growth": self.sd_mm_per_m2 * 1e-6,
            "occluder_rate": float(rate),
            "occluded_per_sd": float(peak * self.occluded * rate),
            "outlier_per_sd": float(peak * self.outlier / self.range_mm),
        }

    def noise_sd(self, depth: FloatArray) -> FloatArray:
        """s(d), mm, of depths, mm."""
        return self.near_sd_mm + self.sd_mm_per_m2 * 1e-6 * depth * depth

    def unexplained(self, depth: FloatArray) -> FloatArray:
        """The misfit of a reading far behind a surface at a depth, mm."""
        return np.log1p(1.0 / (self.uniforms["outlier_per_sd"] * self.noise_sd(depth)))

    def misfit(self, depth: FloatArray, reading: FloatArray) -> FloatArray:
        """rho of readings of the surface, > 0, mm, where it is at a depth, mm."""
        constants, sd = self.uniforms, self.noise_sd(depth)
        rate = constants["occluder_rate"]
        hidden = constants["occluded_per_sd"] * sd / -np.expm1(-rate * depth)
        outlier = constants["outlier_per_sd"] * sd
        here = np.exp(-0.5 * ((reading - depth) / sd) ** 2)
        before = np.where(reading <= depth, hidden * np.exp(-rate * reading), 0.0)
        best = 1.0 + hidden * np.exp(-rate * depth) + outlier
        return np.log(best / (here + before + outlier))

    def misfit_of_other(self, depth: FloatArray, reading: FloatArray) -> FloatArray:
        """rho of readings, > 0, mm, known to be of something else."""
        t = _LOGISTIC_OF_NORMAL * (depth - reading) / self.noise_sd(depth)
        through = np.exp(-self.unexplained(depth))
        # the exponent is bounded: beyond, both shares are 0 or 1 in float32 too
        front = 1.0 / (1.0 + np.exp(np.clip(-t, -80.0, 80.0)))
        return -np.log(front + (1.0 - front) * through)


def misfits_in_numpy(depth: Float32Array, observed: Float32Array, model: PixelMixture) -> FloatArray:
    """The reference for the device's sums of misfits: (N,) over the pixels that have depth and a reading.

    Args:
        depth: (N, h, w) rendered depth, mm, 0 where nothing is drawn.
        observed: (h, w) depth of target pixels, mm; negative other reading; 0 no reading.
        model: of a pixel.
    """
    d = depth.astype(np.float64)
    y = np.broadcast_to(observed.astype(np.float64), d.shape)
    rho = np.zeros_like(d)
    target, other = (d > 0) & (y > 0), (d > 0) & (y < 0)
    rho[target] = model.misfit(d[target], y[target])
    rho[other] = model.misfit_of_other(d[other], -y[other])
    total: FloatArray = rho.sum(axis=(1, 2))
    return total
