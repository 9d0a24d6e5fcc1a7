"""Discrimination and calibration of the confidence against ground truth.

The first axis of all arrays is the frame (M). A frame is correct (r = 1) or wrong (r = 0) by the error limits
of its ``SubjectKind``. The confidence c is the estimated probability that r = 1. It should separate correct
from wrong frames (ROC curve) and be calibrated: a share c of the frames with confidence c is correct.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray

BINS = 10
MOST_THRESHOLDS = 200
"""Maximum number of points of a ROC curve; enough for a plot."""


@dataclass(frozen=True, eq=False)
class JudgedFrames:
    """The frames (M,) of a track with known error, including lost ones.

    Attributes:
        confidence: confidence; NaN and values outside 0 to 1 count as missing.
        right: whether the errors are within the limits.
        far: whether the errors are far beyond the limits.
        lost: whether the frame is marked lost.
        right_if: description of the limits of a correct frame.
        far_if: description of the limits beyond which a frame is far off.
    """

    confidence: FloatArray
    right: BoolArray
    far: BoolArray
    lost: BoolArray
    right_if: str
    far_if: str

    @property
    def scored(self) -> tuple[FloatArray, BoolArray]:
        """Confidence and correctness of the frames with a valid confidence."""
        known = (self.confidence >= 0.0) & (self.confidence <= 1.0)  # False for NaN
        return self.confidence[known], self.right[known]


def pooled_frames(members: Sequence[JudgedFrames]) -> JudgedFrames:
    """Concatenate the judged frames of one or more tracks."""
    return JudgedFrames(
        confidence=np.concatenate([one.confidence for one in members]),
        right=np.concatenate([one.right for one in members]),
        far=np.concatenate([one.far for one in members]),
        lost=np.concatenate([one.lost for one in members]),
        right_if=" / ".join(dict.fromkeys(one.right_if for one in members)),
        far_if=" / ".join(dict.fromkeys(one.far_if for one in members)),
    )


def roc_area(confidence: FloatArray, right: BoolArray) -> float:
    """Return the area under the ROC curve of the confidence; NaN if all frames are correct or all wrong.

    With c+ and c- the confidences of a correct and a wrong frame::

        A = P(c+ > c-) + P(c+ = c-) / 2

    (Hanley and McNeil 1982): 1 for perfect separation, 0.5 for chance level.

    Args:
        confidence: (M,) any numbers; only their order matters.
        right: (M,) whether the frame is correct.
    """
    # Mann-Whitney statistic by binary search: O(M log M) time without the M x M comparison matrix.
    high, low = confidence[right], np.sort(confidence[~right])
    if not len(high) or not len(low):
        return float("nan")
    below, not_above = (np.searchsorted(low, high, side=side) for side in ("left", "right"))
    return float(0.5 * (below + not_above).mean() / len(low))


@dataclass(frozen=True, eq=False)
class RocCurve:
    """Shares of frames kept when frames below a confidence threshold are dropped.

    Attributes:
        confidence: (T,) thresholds, decreasing; the first is infinite and keeps no frame.
        right_kept: (T,) share of the correct frames that is kept, 0 to 1.
        wrong_kept: (T,) share of the wrong frames that is kept, 0 to 1.
    """

    confidence: FloatArray
    right_kept: FloatArray
    wrong_kept: FloatArray


def roc_curve(confidence: FloatArray, right: BoolArray) -> RocCurve | None:
    """Return the ROC curve; None if all frames are correct or all wrong.

    The thresholds are the distinct confidences, thinned to ``MOST_THRESHOLDS`` evenly spaced ranks.
    """
    if right.all() or not right.any():
        return None
    least = np.unique(confidence)[::-1]
    if len(least) > MOST_THRESHOLDS:
        least = least[np.linspace(0, len(least) - 1, MOST_THRESHOLDS).astype(np.int64)]
    kept = (_share_from(confidence[kind], least) for kind in (right, ~right))
    return RocCurve(np.concatenate([[np.inf], least]), *kept)


def _share_from(values: FloatArray, least: FloatArray) -> FloatArray:
    """Return the share of values at or above each threshold (T,), preceded by 0 for an infinite threshold."""
    below = np.searchsorted(np.sort(values), least, side="left")
    return np.concatenate([[0.0], (len(values) - below) / len(values)])


@dataclass(frozen=True)
class Bin:
    """A confidence bin of a reliability diagram.

    Attributes:
        low, high: range of the confidence, half-open; 1 belongs to the last bin.
        count: number of frames.
        confidence: mean confidence; NaN if empty.
        right: share of correct frames; NaN if empty.
    """

    low: float
    high: float
    count: int
    confidence: float
    right: float


def reliability(confidence: FloatArray, right: BoolArray) -> tuple[Bin, ...]:
    """Return the reliability diagram: ``BINS`` confidence bins of equal width.

    Args:
        confidence: (M,) confidence, 0 to 1.
        right: (M,) whether the frame is correct.
    """
    edges = np.arange(BINS + 1) / BINS
    # Clipping puts a confidence of exactly 1 into the last bin.
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
    """Return the expected calibration error; NaN if there are no frames.

    sum_b n_b / M |mean confidence_b - share correct_b| (Naeini et al. 2015), over bins b with n_b frames.
    """
    total = sum(one.count for one in bins)
    away = sum(one.count * abs(one.confidence - one.right) for one in bins if one.count)
    return away / total if total else float("nan")


def brier_score(confidence: FloatArray, right: BoolArray) -> float:
    """Return the mean of (c - r)^2 over frames (M,) (Brier 1950); NaN if there are no frames."""
    return float(((confidence - right) ** 2).mean()) if len(confidence) else float("nan")
