"""How much of a recording was tracked: part of every table, so that errors never hide lost frames."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Coverage:
    """Counts of frames.

    Attributes:
        frames: estimates in the result.
        tracked: of these, not lost (reinitialised ones count as tracked).
        lost: of these, lost. Their errors count all the same.
        reinitialised: of these, found anew.
        unmatched: of these, without a truth at their stamp; all of them when there is no truth.
        missed: truths within the result's span that have no estimate near: frames the run left out.
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
