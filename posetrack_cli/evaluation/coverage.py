"""How much of a recording was tracked: part of every table, so that errors never hide lost frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, IntArray
from posetrack_cli.evaluation.association import Pairs
from posetrack_cli.evaluation.track import Track
from posetrack_cli.recording.timeline import GAP_FACTOR


@dataclass(frozen=True)
class Coverage:
    """Counts of frames.

    Attributes:
        frames: estimates in the result.
        tracked: of these, not lost (reinitialised ones count as tracked).
        lost: of these, lost. Their errors count all the same.
        reinitialised: of these, found anew.
        unmatched: of these, without a truth at their stamp; all of them when there is no truth.
        missed: frames within the result's span that the run left out though there is a truth for them.
        outside: truths before its first or after its last estimate: not asked for, not counted.
        has_truth: whether there was a truth to match.
    """

    frames: int
    tracked: int
    lost: int
    reinitialised: int
    unmatched: int
    missed: int
    outside: int
    has_truth: bool
    tracked_and_matched: int

    @property
    def share(self) -> float:
        """Metric ``coverage``: (tracked and matched) / (frames + missed); without truth tracked / frames.

        0 for an empty result.
        """
        due = self.frames + self.missed
        good = self.tracked_and_matched if self.has_truth else self.tracked
        return good / due if due else 0.0


def measure_coverage(
    track: Track, truth: Track | None, pairs: Pairs | None, *, tolerance_ns: int = 0
) -> Coverage:
    """Count the frames of an estimate, and those of the truth that it should have had.

    A truth may come at another rate than the frames, and a run may have taken every second frame on purpose;
    so a truth without an estimate is no missed frame by itself. Frames are missed where a gap between two
    estimates holds truths that are farther than half the usual interval (and than the tolerance) from both:
    as many as there are such truths, but no more than fit in at the usual interval.

    Args:
        track: the estimate.
        truth, pairs: None without truth.
        tolerance_ns: of the association.
    """
    frames = len(track)
    lost = np.zeros(frames, dtype=np.bool_) if track.lost is None else track.lost
    matched = np.zeros(frames, dtype=np.bool_)
    if pairs is not None:
        matched[pairs.estimate] = True
    true_ns = np.empty(0, dtype=np.int64) if truth is None else truth.stamp_ns
    return Coverage(
        frames=frames,
        tracked=int((~lost).sum()),
        lost=int(lost.sum()),
        reinitialised=0 if track.reinitialised is None else int(track.reinitialised.sum()),
        unmatched=int((~matched).sum()),
        missed=_missed(track.stamp_ns, true_ns, tolerance_ns),
        outside=int(_is_outside(track.stamp_ns, true_ns, tolerance_ns).sum()),
        has_truth=truth is not None,
        tracked_and_matched=int((matched & ~lost).sum()),
    )


def usual_interval(stamp_ns: IntArray) -> float:
    """Return the mean interval, ns, between stamps (N,), N >= 2, that have no gap between them.

    The median tells the gaps (at least half of the intervals are none); the mean of the rest is the frame
    rate's, also where jitter makes intervals long and short in turn, between which a median has to choose.
    """
    intervals = np.diff(stamp_ns)
    return float(intervals[intervals <= GAP_FACTOR * np.median(intervals)].mean())


def _is_outside(stamp_ns: IntArray, true_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """Return which truths (M,) are before the first or after the last estimate; all if there is none."""
    if not stamp_ns.size:
        return np.ones(len(true_ns), dtype=np.bool_)
    before, after = true_ns < stamp_ns[0] - tolerance_ns, true_ns > stamp_ns[-1] + tolerance_ns
    outside: BoolArray = before | after
    return outside


def _missed(stamp_ns: IntArray, true_ns: IntArray, tolerance_ns: int) -> int:
    """Return how many frames are missing between the estimates, as ``measure_coverage`` counts them."""
    if len(stamp_ns) < 2:
        return 0
    intervals, usual = np.diff(stamp_ns), usual_interval(stamp_ns)
    interval = np.searchsorted(stamp_ns, true_ns, side="right") - 1  # between this estimate and the next
    inside = (interval >= 0) & (interval < len(intervals))
    interval, true_ns = interval[inside], true_ns[inside]
    distance = np.minimum(true_ns - stamp_ns[interval], stamp_ns[interval + 1] - true_ns)
    far = distance > max(0.5 * usual, tolerance_ns)
    truths = np.bincount(interval[far], minlength=len(intervals))
    room = np.maximum(np.rint(intervals / usual) - 1.0, 0.0)  # two frames may be nearer than usual
    return int(np.minimum(truths, room).sum())
