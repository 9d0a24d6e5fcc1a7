"""How a reading of depth comes about where a surface is rendered: visible, occluded or an outlier.

The model of a pixel is that of Wüthrich et al. 2013 (dbot): Gaussian noise about the surface, an
exponential density before it for what hides it, and a small uniform one for everything else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray

LOGISTIC_OF_NORMAL = 1.702
"""1 / (1 + exp(-1.702 t)) is the normal distribution function to .01 (Camilli 1994)."""
REACH_PX = 2
"""How far beside itself a target pixel looks for what is drawn."""
LOOKS_BESIDE = 2.0
FAR_PX = 1e4


@dataclass(frozen=True)
class PixelMixture:
    """The density of a reading y where the surface is at depth d, and its misfit.

        p(y | d) = v N(y; d, s(d)^2) + o l exp(-l y) [y <= d] / (1 - exp(-l d)) + u / range

    with v = 1 - o - u. The misfit is rho(y, d) = log p(d | d) - log p(y | d): 0 for a perfect reading.
    It grows like a square, bends at some 3 s and goes to ``unexplained(d)`` behind the surface and less
    in front of it.

    A reading known to be of something else (the image's negative numbers) is there whether or not the
    surface is behind it: y = min(surface, other things), so where it lies in front it says nothing about
    the surface and costs nothing. Where it lies behind, one would look through the surface: an outlier, or
    an outline that is off by the distance x to the nearest target pixel **[ours]**. With F the probability
    that noise of s(d) has not exchanged the two, and b(x) the share that an outline leaves,

        b(x) = (exp(-x^2 / (2 s_o^2)) + e) / (1 + e)      e = 1 / (exp(unexplained(d)) - 1)
        rho(-y, d, x) = -log(F((d - y) / s) + (1 - F) b(x))

    A missing reading costs ``unread_weight`` times -log b(x): beside a hand most readings are missing. A
    target pixel that nothing covers costs ``unexplained``. It, and one whose misfit is above
    ``LOOKS_BESIDE``, may be explained by what is drawn up to ``REACH_PX`` beside it, x away, as if the
    outline were off there: then v N(y; d, s^2) is times exp(-x^2 / (2 s_o^2)). So an outline, also one
    finger's before another, counts as a square near the truth, as depth does, not as an edge.

    Attributes:
        near_sd_mm, sd_mm_per_m2: s(d) = near_sd_mm + sd_mm_per_m2 d^2, d in metres.
        occluded: o, the share of readings that are of unknown things in front.
        half_life_mm: ln 2 / l, over which such things get half as frequent.
        outlier: u, the share of readings that nothing explains.
        range_mm: of the sensor, over which they are spread.
        outline_sd_mm: s_o, of where the target's outline is seen against where it is drawn.
        unread_weight: what a missing reading counts of one behind.
    """

    near_sd_mm: float = 1.5
    sd_mm_per_m2: float = 0.7
    occluded: float = 0.1
    half_life_mm: float = 1000.0
    outlier: float = 0.1
    range_mm: float = 4500.0
    outline_sd_mm: float = 1.5
    unread_weight: float = 0.2

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
            "outline_sd": self.outline_sd_mm,
            "unread_weight": self.unread_weight,
        }

    def noise_sd(self, depth: FloatArray) -> FloatArray:
        """s(d), mm, of depths, mm."""
        return self.near_sd_mm + self.sd_mm_per_m2 * 1e-6 * depth * depth

    def unexplained(self, depth: FloatArray) -> FloatArray:
        """The misfit of a reading far behind a surface at a depth, mm."""
        return np.log1p(1.0 / (self.uniforms["outlier_per_sd"] * self.noise_sd(depth)))

    def misfit(self, depth: FloatArray, reading: FloatArray, off_mm: FloatArray | float = 0.0) -> FloatArray:
        """rho of readings of the surface, > 0, where it is at a depth and drawn ``off_mm`` aside."""
        constants, sd = self.uniforms, self.noise_sd(depth)
        rate = constants["occluder_rate"]
        hidden = constants["occluded_per_sd"] * sd / -np.expm1(-rate * depth)
        outlier = constants["outlier_per_sd"] * sd
        here = np.exp(-0.5 * (((reading - depth) / sd) ** 2 + np.square(off_mm / self.outline_sd_mm)))
        before = np.where(reading <= depth, hidden * np.exp(-rate * reading), 0.0)
        best = 1.0 + hidden * np.exp(-rate * depth) + outlier
        return np.log(best / (here + before + outlier))

    def beside(self, depth: FloatArray, off_mm: FloatArray) -> FloatArray:
        """b of an outline that is off by ``off_mm``, at a depth, mm."""
        outlier = self.uniforms["outlier_per_sd"] * self.noise_sd(depth)
        return (np.exp(-0.5 * np.square(off_mm / self.outline_sd_mm)) + outlier) / (1.0 + outlier)

    def misfit_of_other(self, depth: FloatArray, reading: FloatArray, off_mm: FloatArray) -> FloatArray:
        """rho of readings, > 0, mm, known to be of something else, ``off_mm`` beside the target."""
        t = LOGISTIC_OF_NORMAL * (depth - reading) / self.noise_sd(depth)
        # the exponent is bounded: beyond, both shares are 0 or 1 in float32 too
        front = 1.0 / (1.0 + np.exp(np.clip(-t, -80.0, 80.0)))
        return -np.log(front + (1.0 - front) * self.beside(depth, off_mm))

    def misfit_of_unread(self, depth: FloatArray, off_mm: FloatArray) -> FloatArray:
        """rho where there is no reading, ``off_mm`` beside the target."""
        return -self.unread_weight * np.log(self.beside(depth, off_mm))


def outline_distances(observed: Float32Array) -> Float32Array:
    """(h, w) distance of each pixel from the nearest target pixel (> 0), pixels; FAR where there is none."""
    import cv2

    target = observed > 0
    if not target.any():
        return np.full(observed.shape, FAR_PX, dtype=np.float32)
    return cv2.distanceTransform((~target).astype(np.uint8), cv2.DIST_L2, 5).astype(np.float32)


def misfits_in_numpy(
    depth: Float32Array, observed: Float32Array, model: PixelMixture, slope: float
) -> tuple[FloatArray, FloatArray]:
    """The reference for the device's sums: misfits (N,) over the drawn pixels, and relief (N,).

    The relief is what target pixels that nothing covers cost less than ``unexplained`` because of what is
    drawn beside them.

    Args:
        depth: (N, h, w) rendered depth, mm, 0 where nothing is drawn.
        observed: (h, w) depth of target pixels, mm; negative other reading; 0 no reading.
        model: of a pixel.
        slope: a pixel's width, mm, per mm of depth.
    """
    d = depth.astype(np.float64)
    y = np.broadcast_to(observed.astype(np.float64), d.shape)
    off = np.broadcast_to(outline_distances(observed), d.shape) * slope * d
    rho = np.zeros_like(d)
    target, other, unread = (d > 0) & (y > 0), (d > 0) & (y < 0), (d > 0) & (y == 0)
    rho[target] = model.misfit(d[target], y[target])
    rho[other] = model.misfit_of_other(d[other], -y[other], off[other])
    rho[unread] = model.misfit_of_unread(d[unread], off[unread])
    beside = _misfits_with_neighbours(d, y, model, slope)
    rho = np.where(target & (rho > LOOKS_BESIDE), np.minimum(rho, beside), rho)
    relief = np.where((d == 0) & (y > 0), np.maximum(0.0, model.unexplained(y) - beside), 0.0)
    return rho.sum(axis=(1, 2)), relief.sum(axis=(1, 2))


def _misfits_with_neighbours(
    depth: FloatArray, reading: FloatArray, model: PixelMixture, slope: float
) -> FloatArray:
    """(N, h, w) misfit of each target pixel with what fits best of what is drawn ``REACH_PX`` beside it.

    Best is where (y - d)^2 / s(y)^2 + x^2 / s_o^2 is least; infinite where nothing is drawn.
    """
    _, height, width = depth.shape
    reach = REACH_PX
    padded = np.pad(depth, ((0, 0), (reach, reach), (reach, reach)))
    least = np.full(depth.shape, np.inf)
    misfits = np.full(depth.shape, np.inf)
    for j in range(-reach, reach + 1):
        for i in range(-reach, reach + 1):
            if 0 < i * i + j * j <= reach * reach:
                d = padded[:, reach + j : reach + j + height, reach + i : reach + i + width]
                off = np.hypot(i, j) * slope * reading
                square = ((reading - d) / model.noise_sd(reading)) ** 2 + (off / model.outline_sd_mm) ** 2
                use = (d > 0) & (reading > 0) & (square < least)
                least[use] = square[use]
                misfits[use] = model.misfit(d[use], reading[use], off[use])
    return misfits
