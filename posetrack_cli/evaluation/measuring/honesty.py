"""What a track says of itself, against the truth: is confidence a probability, does it tell right from wrong?

Frames (M) come first in every array. A frame is right (r = 1) or wrong (r = 0) by the limits of its
``SubjectKind``. Confidence c is the probability that it is right: it should be higher in right frames than in
wrong ones, and of the frames that state c the share c should be right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray

BINS = 10
MOST_THRESHOLDS = 200
"""Of a ROC curve: more cannot be told apart in a plot."""


@dataclass(frozen=True, eq=False)
class JudgedFrames:
    """The frames (M,) of a track whose error is known, lost ones among them, and what it says of them.

    Attributes:
        confidence: as stated; what is not within 0 and 1, NaN too, counts as none.
        right: the error is within its limits.
        far: the error is far beyond.
        lost: frames that say themselves that they are lost.
        right_if: what makes a frame right, in words.
        far_if: what makes it far off.
    """

    confidence: FloatArray
    right: BoolArray
    far: BoolArray
    lost: BoolArray
    right_if: str
    far_if: str

    @property
    def scored(self) -> tuple[FloatArray, BoolArray]:
        """Confidence and whether it is right, of the frames that state a probability."""
        known = (self.confidence >= 0.0) & (self.confidence <= 1.0)
        return self.confidence[known], self.right[known]


def pooled_frames(members: Sequence[JudgedFrames]) -> JudgedFrames:
    """Return the frames of one or more tracks as those of one: each frame counts alike."""
    return JudgedFrames(
        confidence=np.concatenate([one.confidence for one in members]),
        right=np.concatenate([one.right for one in members]),
        far=np.concatenate([one.far for one in members]),
        lost=np.concatenate([one.lost for one in members]),
        right_if=" / ".join(dict.fromkeys(one.right_if for one in members)),
        far_if=" / ".join(dict.fromkeys(one.far_if for one in members)),
    )


def roc_area(confidence: FloatArray, right: BoolArray) -> float:
    """Return the area under the ROC curve of confidence against right, NaN where all are right or none is.

    With c+ the confidence of a frame that is right and c- of one that is not::

        A = P(c+ > c-) + P(c+ = c-) / 2

    (Hanley and McNeil 1982): 1 where confidence tells all apart, 0.5 where it says nothing.

    Args:
        confidence: (M,) any numbers; only their order counts.
        right: (M,).
    """
    high, low = confidence[right], np.sort(confidence[~right])
    if not len(high) or not len(low):
        return float("nan")
    below, not_above = (np.searchsorted(low, high, side=side) for side in ("left", "right"))
    return float(0.5 * (below + not_above).mean() / len(low))


@dataclass(frozen=True, eq=False)
class RocCurve:
    """What is left where frames below a confidence are dropped.

    Attributes:
        confidence: (T,) the least that is kept, decreasing; the first is infinite and keeps nothing.
        right_kept: (T,) share of the right frames, 0 to 1.
        wrong_kept: (T,) share of the wrong frames, 0 to 1.
    """

    confidence: FloatArray
    right_kept: FloatArray
    wrong_kept: FloatArray


def roc_curve(confidence: FloatArray, right: BoolArray) -> RocCurve | None:
    """Return the ROC curve, None where all are right or none is.

    Its corners are at the confidences (M,) that occur; of more than ``MOST_THRESHOLDS`` those are taken that
    stand in equal distances in their order, the smallest among them.
    """
    if right.all() or not right.any():
        return None
    least = np.unique(confidence)[::-1]
    if len(least) > MOST_THRESHOLDS:
        least = least[np.linspace(0, len(least) - 1, MOST_THRESHOLDS).astype(np.int64)]
    kept = (_share_from(confidence[kind], least) for kind in (right, ~right))
    return RocCurve(np.concatenate([[np.inf], least]), *kept)


def _share_from(values: FloatArray, least: FloatArray) -> FloatArray:
    """The share of the values that is not below each threshold (T,), after a 0 for one that none reaches."""
    below = np.searchsorted(np.sort(values), least, side="left")
    return np.concatenate([[0.0], (len(values) - below) / len(values)])


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


def reliability(confidence: FloatArray, right: BoolArray) -> tuple[Bin, ...]:
    """Return ``BINS`` bins of equal width: in each the confidence should be the share that is right.

    Args:
        confidence: (M,) 0 to 1.
        right: (M,).
    """
    edges = np.arange(BINS + 1) / BINS
    places = np.clip(np.searchsorted(edges, confidence, side="right") - 1, 0, BINS - 1)
    return tuple(
        _bin(float(low), float(high), confidence[places == place], right[places == place])
        for place, (low, high) in enumerate(pairwise(edges))
    )


def _bin(low: float, high: float, confidence: FloatArray, right: BoolArray) -> Bin:
    if not len(right):
        return Bin(low, high, 0, float("nan"), float("nan"))
    return Bin(low, high, len(right), float(confidence.mean()), float(right.mean()))


def calibration_error(bins: Sequence[Bin]) -> float:
    """Return the expected calibration error, NaN of no frame.

    sum_b n_b / M |mean confidence_b - share right_b| (Naeini et al. 2015), over the bins b of n_b frames.
    """
    total = sum(one.count for one in bins)
    away = sum(one.count * abs(one.confidence - one.right) for one in bins if one.count)
    return away / total if total else float("nan")


def brier_score(confidence: FloatArray, right: BoolArray) -> float:
    """Return the mean of (c - r)^2 over frames (M,) (Brier 1950), NaN of none; saying 0.5 always has 0.25."""
    return float(((confidence - right) ** 2).mean()) if len(confidence) else float("nan")
