"""What the device hands back per tile, and the same sums in numpy.

With r the pixels that a tile's rendering covers and o the target pixels of the observed image:
the sum over r and o of min(|d - y|, c_max); |r and o|; |r \\ o| where there is another reading, and how
many of those readings are in front; |r \\ o| where there is none; the sum of the readings' misfits; how many
pixels of r and o agree; the relief of o \\ r. Every cost of the papers and of ours is made of these and of
|o|.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.rendering.pixel_model import PixelMixture, misfits_in_numpy


class Comparison(NamedTuple):
    """What rendered depth is compared with, and how.

    Attributes:
        observed: (h, w) float32: depth of a target pixel, mm; negative where the reading is of something
            else; 0 where there is none.
        clamp_mm: c_max of eq. (4).
        model: of a pixel, for the misfits; without one they are 0.
        match_mm: depths that differ by less agree; at 0 none do.
    """

    observed: Float32Array
    clamp_mm: float
    model: PixelMixture | None = None
    match_mm: float = 0.0


@dataclass(frozen=True)
class TileSums:
    """Sums over the pixels of each of N tiles.

    Attributes:
        error: (N,) sum of min(|d - y|, c_max) where both are, mm.
        both: (N,) number of pixels rendered and observed.
        rendered_only: (N,) rendered, but the reading there is not of the target.
        unread: (N,) rendered where the sensor has no reading.
        misfit: (N,) sum of rho of a pixel model over the rendered pixels; 0 where no model is given.
        occluded: (N,) those of ``rendered_only`` whose reading is in front of what is rendered.
        matched: (N,) those of ``both`` with |d - y| below the distance asked for; 0 where none is.
        relief: (N,) what the target pixels that nothing covers cost less because something beside them is
            covered; 0 where no model is given.
        observed: number of target pixels, the same for all tiles.
    """

    error: FloatArray
    both: FloatArray
    rendered_only: FloatArray
    unread: FloatArray
    misfit: FloatArray
    occluded: FloatArray
    matched: FloatArray
    relief: FloatArray
    observed: float

    @classmethod
    def from_rows(cls, rows: Float32Array | FloatArray, observed: float) -> TileSums:
        """From the (N, 8) array that the device returns."""
        error, both, rendered_only, unread, misfit, occluded, matched, relief = rows.astype(np.float64).T
        return cls(error, both, rendered_only, unread, misfit, occluded, matched, relief, observed)


def sums_in_numpy(depth: Float32Array, comparison: Comparison, slope: float = 0.0) -> TileSums:
    """The reference for the device's sums.

    Args:
        depth: (N, h, w) rendered depth, mm, 0 where nothing is drawn.
        comparison: what it is compared with.
        slope: a pixel's width, mm, per mm of depth, for the misfits.
    """
    observed, clamp_mm, model, match_mm = comparison
    r = depth > 0
    o, other, unread = observed > 0, observed < 0, observed == 0
    apart = np.abs(depth.astype(np.float64) - observed)
    error = np.minimum(apart, clamp_mm)
    nothing = np.zeros(len(depth))
    misfit, relief = (nothing, nothing) if model is None else misfits_in_numpy(depth, observed, model, slope)
    return TileSums(
        np.where(r & o, error, 0.0).sum(axis=(1, 2)),
        (r & o).sum(axis=(1, 2)).astype(np.float64),
        (r & other).sum(axis=(1, 2)).astype(np.float64),
        (r & unread).sum(axis=(1, 2)).astype(np.float64),
        misfit,
        (r & other & (-observed < depth)).sum(axis=(1, 2)).astype(np.float64),
        (r & o & (apart < match_mm)).sum(axis=(1, 2)).astype(np.float64),
        relief,
        float(o.sum()),
    )
