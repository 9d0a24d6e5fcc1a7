"""What the device hands back per tile, and the same sums in numpy.

With r the pixels that a tile's rendering covers and o the target pixels of the observed image:
the sum over r and o of min(|d - y|, c_max); |r and o|; |r \\ o| where there is another reading;
|r \\ o| where there is none. Every cost of the paper and of ours is made of these four and of |o|.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray


@dataclass(frozen=True)
class TileSums:
    """Sums over the pixels of each of N tiles.

    Attributes:
        error: (N,) sum of min(|d - y|, c_max) where both are, mm.
        both: (N,) number of pixels rendered and observed.
        rendered_only: (N,) rendered, but the reading there is not of the target.
        unread: (N,) rendered where the sensor has no reading.
        observed: number of target pixels, the same for all tiles.
    """

    error: FloatArray
    both: FloatArray
    rendered_only: FloatArray
    unread: FloatArray
    observed: float

    @classmethod
    def from_rows(cls, rows: Float32Array, observed: float) -> TileSums:
        """From the (N, 4) array that the device returns."""
        error, both, rendered_only, unread = np.asarray(rows, dtype=np.float64).T
        return cls(error, both, rendered_only, unread, observed)


def sums_in_numpy(depth: Float32Array, observed: Float32Array, clamp_mm: float) -> TileSums:
    """The reference for the device's sums.

    Args:
        depth: (N, h, w) rendered depth, mm, 0 where nothing is drawn.
        observed: (h, w) depth of target pixels, mm; negative other reading; 0 no reading.
        clamp_mm: c_max.
    """
    r = depth > 0
    o, other, unread = observed > 0, observed < 0, observed == 0
    error = np.minimum(np.abs(depth.astype(np.float64) - observed), clamp_mm)
    return TileSums(
        np.where(r & o, error, 0.0).sum(axis=(1, 2)),
        (r & o).sum(axis=(1, 2)).astype(np.float64),
        (r & other).sum(axis=(1, 2)).astype(np.float64),
        (r & unread).sum(axis=(1, 2)).astype(np.float64),
        float(o.sum()),
    )
