"""Pixel model of depth readings at a rendered surface: visible, occluded or outlier.

As in Wüthrich et al. 2013 (dbot): Gaussian noise about the surface, an exponential density in front of it
for occluders, and a small uniform density for everything else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray

LOGISTIC_OF_NORMAL = 1.702
"""1 / (1 + exp(-1.702 t)) approximates the normal distribution function to .01 (Camilli 1994)."""
REACH_PX = 2
"""Radius in which a target pixel is matched with rendered surfaces next to it."""
NEIGHBOUR_MISFIT = 2.0
FAR_PX = 1e4


@dataclass(frozen=True)
class PixelMixture:
    """Density of a reading y for a surface at depth d, and its misfit.

        p(y | d) = v N(y; d, s(d)^2) + o l exp(-l y) [y <= d] / (1 - exp(-l d)) + u / range

    with v = 1 - o - u. The misfit is rho(y, d) = log p(d | d) - log p(y | d), which is 0 for a perfect
    reading. It is quadratic near 0, flattens at about 3 s, and tends to ``unexplained(d)`` behind the
    surface and to less in front of it.

    Readings known to belong to something else (negative in the image) exist independently of the surface: y
    = min(surface, other objects). In front of the surface they have no information on it and cost nothing.
    Behind it they contradict the surface, unless they are outliers or the outline is off by the distance x
    to the nearest target pixel **[ours]**. With F the probability that noise of s(d) has not exchanged the
    two, and b(x) the probability of an outline error,

        b(x) = (exp(-x^2 / (2 s_o^2)) + e) / (1 + e)      e = 1 / (exp(unexplained(d)) - 1)
        rho(-y, d, x) = -log(F((d - y) / s) + (1 - F) b(x))

    A missing reading costs ``unread_weight`` times -log b(x), as most missing readings are near the hand's
    outline. An uncovered target pixel costs ``unexplained``. Such pixels, and those with a misfit above
    ``NEIGHBOUR_MISFIT``, may be explained by a surface rendered up to ``REACH_PX`` away, at distance x, as an
    outline error: v N(y; d, s^2) is then multiplied by exp(-x^2 / (2 s_o^2)). The cost of outlines,
    including that of one finger in front of another, is thus quadratic near the truth like that of depth,
    instead of a step.

    Attributes:
        near_sd_mm, sd_mm_per_m2: s(d) = near_sd_mm + sd_mm_per_m2 d^2, d in metres.
        occluded: o, probability of an unknown occluder in front.
        half_life_mm: ln 2 / l, distance over which the density of occluders halves.
        outlier: u, probability of an outlier.
        range_mm: sensor range, over which outliers are uniform.
        outline_sd_mm: s_o, deviation between the observed and the rendered outline.
        unread_weight: cost of a missing reading relative to one behind the surface.
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
        """Parameters of the misfit in ``tile_sums.comp``, by name."""
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
        """Return s(d), mm, for depths in mm."""
        return self.near_sd_mm + self.sd_mm_per_m2 * 1e-6 * depth * depth

    def unexplained(self, depth: FloatArray) -> FloatArray:
        """Return the misfit of a reading far behind a surface at a depth, mm."""
        return np.log1p(1.0 / (self.uniforms["outlier_per_sd"] * self.noise_sd(depth)))

    def misfit(self, depth: FloatArray, reading: FloatArray, off_mm: FloatArray | float = 0.0) -> FloatArray:
        """Return rho of target readings > 0 for a surface at a depth that is rendered ``off_mm`` away."""
        constants, sd = self.uniforms, self.noise_sd(depth)
        rate = constants["occluder_rate"]
        hidden = constants["occluded_per_sd"] * sd / -np.expm1(-rate * depth)
        outlier = constants["outlier_per_sd"] * sd
        here = np.exp(-0.5 * (((reading - depth) / sd) ** 2 + np.square(off_mm / self.outline_sd_mm)))
        before = np.where(reading <= depth, hidden * np.exp(-rate * reading), 0.0)
        best = 1.0 + hidden * np.exp(-rate * depth) + outlier
        return np.log(best / (here + before + outlier))

    def beside(self, depth: FloatArray, off_mm: FloatArray) -> FloatArray:
        """Return b for an outline error of ``off_mm`` at a depth, mm."""
        outlier = self.uniforms["outlier_per_sd"] * self.noise_sd(depth)
        return (np.exp(-0.5 * np.square(off_mm / self.outline_sd_mm)) + outlier) / (1.0 + outlier)

    def misfit_of_other(self, depth: FloatArray, reading: FloatArray, off_mm: FloatArray) -> FloatArray:
        """Return rho of readings > 0, mm, of other objects, ``off_mm`` from the target."""
        t = LOGISTIC_OF_NORMAL * (depth - reading) / self.noise_sd(depth)
        # bounded exponent: beyond it, both shares are 0 or 1 even in float32
        front = 1.0 / (1.0 + np.exp(np.clip(-t, -80.0, 80.0)))
        return -np.log(front + (1.0 - front) * self.beside(depth, off_mm))

    def misfit_of_unread(self, depth: FloatArray, off_mm: FloatArray) -> FloatArray:
        """Return rho of missing readings, ``off_mm`` from the target."""
        return -self.unread_weight * np.log(self.beside(depth, off_mm))


def outline_distances(observed: Float32Array) -> Float32Array:
    """Return the distance (h, w) of each pixel to the nearest target pixel, pixels; FAR_PX without any."""
    import cv2

    target = observed > 0
    if not target.any():
        return np.full(observed.shape, FAR_PX, dtype=np.float32)
    return cv2.distanceTransform((~target).astype(np.uint8), cv2.DIST_L2, 5).astype(np.float32)


def misfits_in_numpy(
    depth: Float32Array, observed: Float32Array, model: PixelMixture, slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return misfits (N,) over the rendered pixels, and relief (N,); reference for the devices' sums.

    The relief is the cost reduction below ``unexplained`` of uncovered target pixels due to surfaces next
    to them.

    Args:
        depth: (N, h, w) rendered depth, mm, 0 where empty.
        observed: (h, w) depth of target pixels, mm; negative for other readings; 0 for none.
        model: pixel model.
        slope: width of a pixel, mm, per mm of depth.
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
    rho = np.where(target & (rho > NEIGHBOUR_MISFIT), np.minimum(rho, beside), rho)
    relief = np.where((d == 0) & (y > 0), np.maximum(0.0, model.unexplained(y) - beside), 0.0)
    return rho.sum(axis=(1, 2)), relief.sum(axis=(1, 2))


def _misfits_with_neighbours(
    depth: FloatArray, reading: FloatArray, model: PixelMixture, slope: float
) -> FloatArray:
    """Return the misfit (N, h, w) of each target pixel with the best-fitting surface within ``REACH_PX``.

    The best minimises (y - d)^2 / s(y)^2 + x^2 / s_o^2; infinite if there is no surface.
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
