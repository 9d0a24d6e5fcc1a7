"""Figures of tracks as arrays: frames (M,) in the order of time, lengths in mm."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray

JUMP_MM = 100.0
OFF_MM = 60.0
"""A wrist that is farther from the true one is not on it."""


def jumps(moved: FloatArray, truly_moved: FloatArray) -> int:
    """Count the frames in which the hand moves more than ``JUMP_MM`` farther than the true one does.

    Args:
        moved: (M,) mean over the joints of how far each went since the frame before.
        truly_moved: (M,) the same of the truth.
    """
    return int((moved - truly_moved > JUMP_MM).sum())


def found_within(wrist: FloatArray, lost: BoolArray) -> int | None:
    """Return in how many frames the hand is found: the first, from 1, that is on the wrist; None if none is.

    Args:
        wrist: (M,) distance between estimated and true wrist; on it are at most ``OFF_MM``.
        lost: (M,) frames that say themselves that they are no find.
    """
    found = np.flatnonzero((wrist <= OFF_MM) & ~lost)
    return int(found[0]) + 1 if len(found) else None


def off_unsaid(wrist: FloatArray, lost: BoolArray) -> int:
    """Count the frames whose wrist is more than ``OFF_MM`` off and which do not say that they are lost."""
    return int(((wrist > OFF_MM) & ~lost).sum())


def kept(wrist: FloatArray) -> float:
    """Return the share of frames whose wrist is less than ``OFF_MM`` off, NaN of none."""
    return float((wrist < OFF_MM).mean()) if len(wrist) else float("nan")
