"""Metrics of what a track says of itself against truth: by confidence, and by its status."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from posetrack_cli.arrays import BoolArray
from posetrack_cli.evaluation import honesty
from posetrack_cli.evaluation.honesty import JudgedFrames
from posetrack_cli.evaluation.metrics.measures import Matched, Measures, rows_of
from posetrack_cli.evaluation.subjects.kind import SubjectKind

WRONG, FAR_TRACKED, RIGHT_LOST = "frames_wrong", "frames_far_tracked", "frames_right_lost"
ROC_AREA = "confidence_roc_area"
BRIER, CALIBRATION = "confidence_brier_score", "confidence_calibration_error"
OF_CONFIDENCE = (ROC_AREA, BRIER, CALIBRATION)
HONESTY = (WRONG, FAR_TRACKED, RIGHT_LOST, *OF_CONFIDENCE)
"""All that is measured here."""
ALL_WRONG, ALL_RIGHT = "no frame is right", "no frame is wrong"
NO_CONFIDENCE = "the result states no confidence"


def judged_frames(measures: Measures, matched: Matched, kind: SubjectKind) -> JudgedFrames | None:
    """Return which of the matched frames are right and which far off, by their errors as they are measured.

    A frame counts whose errors are known. Errors that the truth does not allow do not decide, but the first
    that the kind names must be there; else there is nothing to judge by, which is None, and why is kept.

    Args:
        measures: has the errors by frame already, and takes the reason.
        matched: the frames.
        kind: of the subject: what is right.
    """
    first = next(iter(kind.right), None)
    if first is None:
        return None
    if first not in measures.series:
        reason = measures.absent.get(first, measures.nothing)
        measures.lack(reason, *HONESTY)
        return None
    right, far = (_measured(measures, limits) for limits in (kind.right, kind.far))
    errors = [measures.series[name] for name in dict.fromkeys((*right, *far))]
    known = np.logical_and.reduce([np.isfinite(one) for one in errors])
    estimate, rows = matched.estimate, matched.pairs.estimate
    unstated = np.full(len(rows), np.nan)
    lost = np.zeros(len(rows), dtype=np.bool_) if estimate.lost is None else rows_of(estimate.lost, rows)
    confidence = unstated if estimate.confidence is None else rows_of(estimate.confidence, rows)
    return JudgedFrames(
        confidence=confidence[known],
        right=~_beyond_any(measures, right)[known],
        far=_beyond_any(measures, far)[known],
        lost=lost[known],
        right_if=kind.in_words(right, "at most", " and "),
        far_if=kind.in_words(far, "above", " or "),
    )


def _measured(measures: Measures, limits: Mapping[str, float]) -> dict[str, float]:
    """The limits of those errors that there are."""
    return {name: limit for name, limit in limits.items() if name in measures.series}


def _beyond_any(measures: Measures, limits: Mapping[str, float]) -> BoolArray:
    """In which frames (M,) an error is above its limit."""
    beyond: BoolArray = np.logical_or.reduce([measures.series[name] > most for name, most in limits.items()])
    return beyond


def honesty_metrics(measures: Measures, judged: JudgedFrames) -> None:
    """Add how well confidence and status agree with what is right; see ``evaluation.honesty``.

    Args:
        measures: where to.
        judged: the frames, of one track or of several pooled.
    """
    measures.share(WRONG, ~judged.right)
    measures.share(FAR_TRACKED, judged.far & ~judged.lost)
    if judged.right.any():
        measures.share(RIGHT_LOST, judged.lost[judged.right])
    else:
        measures.lack(ALL_WRONG if len(judged.right) else measures.nothing, RIGHT_LOST)
    confidence, right = judged.scored
    if not len(right):
        return measures.lack(NO_CONFIDENCE if len(judged.right) else measures.nothing, *OF_CONFIDENCE)
    measures.metrics[BRIER] = honesty.brier_score(confidence, right)
    measures.metrics[CALIBRATION] = honesty.calibration_error(honesty.reliability(confidence, right))
    if right.all() or not right.any():
        return measures.lack(ALL_RIGHT if right.all() else ALL_WRONG, ROC_AREA)
    measures.metrics[ROC_AREA] = honesty.roc_area(confidence, right)
