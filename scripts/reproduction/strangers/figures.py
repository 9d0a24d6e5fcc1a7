"""Figures of tracks as arrays: frames (M,) in the order of time, lengths in mm."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray

JUMP_MM = 100.0
OFF_MM = 60.0
"""A wrist that is farther from the true one is not on it."""
BINS = 10


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


def roc_area(scores: FloatArray, right: BoolArray) -> float:
    """Return the area under the ROC curve of scores (M,) that are to be higher where something is right.

    That is P(s+ > s-) + P(s+ = s-) / 2 with s+ the score of a frame that is right and s- of one that is not
    (Hanley and McNeil 1982): 1 tells them apart, 0.5 does not. NaN where one of the kinds is missing.
    """
    high, low = scores[right], np.sort(scores[~right])
    if not len(high) or not len(low):
        return float("nan")
    below, not_above = (np.searchsorted(low, high, side=side) for side in ("left", "right"))
    return float(0.5 * (below + not_above).mean() / len(low))


def brier_score(confidence: FloatArray, right: BoolArray) -> float:
    """Return mean (c - r)^2 (Brier 1950) of confidences (M,), r = 1 where right, else 0; NaN of none."""
    return float(((confidence - right) ** 2).mean()) if len(confidence) else float("nan")


@dataclass(frozen=True)
class Bin:
    """Frames of like confidence.

    Attributes:
        low, high: confidences from low on, below high; those of 1 belong to the last.
        count: frames.
        confidence: their mean, NaN of none.
        right: share of them that is right, NaN of none.
    """

    low: float
    high: float
    count: int
    confidence: float
    right: float


def reliability(confidence: FloatArray, right: BoolArray) -> Iterator[Bin]:
    """Yield ``BINS`` bins of equal width: in each the confidence should be the share that is right."""
    edges = np.arange(BINS + 1) / BINS
    places = np.clip(np.searchsorted(edges, confidence, side="right") - 1, 0, BINS - 1)
    for place, (low, high) in enumerate(pairwise(edges)):
        own = places == place
        means = (float(v[own].mean()) if own.any() else float("nan") for v in (confidence, right))
        yield Bin(float(low), float(high), int(own.sum()), *means)
