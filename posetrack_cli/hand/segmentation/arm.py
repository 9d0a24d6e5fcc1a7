"""Where a hand ends: the wrist, found along the arm by how wide the surface is there."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray

BIN_MM = 4.0
"""Length of the slices of an arm."""


def slice_areas(along: FloatArray, areas: FloatArray, first_mm: float, count: int) -> FloatArray:
    """Area per length (count,), mm, that is the width seen, of slices across an arm.

    Args:
        along: (P,) where pixels lie along the arm, mm.
        areas: (P,) what each covers, mm^2.
        first_mm: where the first slice begins; each is ``BIN_MM`` long.
        count: how many slices.
    """
    number = np.floor((along - first_mm) / BIN_MM).astype(np.int64)
    valid = (number >= 0) & (number < count)
    return np.bincount(number[valid], weights=areas[valid], minlength=count) / BIN_MM
