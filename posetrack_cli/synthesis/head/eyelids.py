"""The eyes' openings: where the lids' edges run, in the average head's x and y."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import MEAN_SHAPE

INNER, OUTER = MEAN_SHAPE[2, :2], MEAN_SHAPE[3, :2]
"""Corners of the left eye."""
LENGTH = float(np.linalg.norm(OUTER - INNER))


def along_and_above(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where places lie on their side's eye: s, 0 at the inner corner, 1 at the outer, and mm above.

    Args:
        x, y: (...) mm; the right eye is the left one's mirror image.
    """
    axis = (OUTER - INNER) / LENGTH
    dx, dy = np.abs(x) - INNER[0], y - INNER[1]
    return (dx * axis[0] + dy * axis[1]) / LENGTH, dy * axis[0] - dx * axis[1]


def upper_edge(s: FloatArray, most: float) -> FloatArray:
    """Return the upper lid's height (...), mm above the line between the corners; 0 beyond them."""
    inside = np.clip(s, 0.0, 1.0)
    edge: FloatArray = most * (4.0 * inside * (1.0 - inside)) ** 0.75 * (1.06 - 0.12 * inside)
    return edge


def lower_edge(s: FloatArray, most: float) -> FloatArray:
    """Return the lower lid's height (...), mm, negative."""
    inside = np.clip(s, 0.0, 1.0)
    edge: FloatArray = -most * (4.0 * inside * (1.0 - inside)) ** 0.85 * (0.92 + 0.16 * inside)
    return edge
