"""Rate, gaps and order of a sequence of stamps."""

from __future__ import annotations

from array import array
from statistics import median

from posetrack_cli.recording.plausibility import StampCheck
from posetrack_cli.units import NS_PER_S

GAP_FACTOR = 1.5
"""An interval that is longer than this many usual ones lacks a frame."""
LONGEST_NS = 2**64 - 1


class Timeline:
    """Collects stamps one by one, 8 bytes each.

    Attributes:
        count: stamps so far.
        not_later: stamps that were not later than the latest before them; readers drop these frames.
    """

    def __init__(self) -> None:
        self.count = 0
        self.not_later = 0
        self._first = 0
        self._latest = 0
        self._intervals = array("Q")
        self._check = StampCheck()

    def add(self, stamp_ns: int) -> None:
        """Take the next stamp, ns."""
        self.count += 1
        if self.count == 1 or stamp_ns > self._latest:
            self._check.add(self.count - 1, stamp_ns)
        if self.count == 1:
            self._first = self._latest = stamp_ns
        elif stamp_ns > self._latest:
            self._intervals.append(min(stamp_ns - self._latest, LONGEST_NS))
            self._latest = stamp_ns
        else:
            self.not_later += 1

    @property
    def remarks(self) -> tuple[str, ...]:
        """What of the stamps cannot be meant if they are frames', one line each."""
        return self._check.remarks

    def summary(self) -> dict[str, int | float | None]:
        """Return start and duration, median rate, largest gap, and how often things went wrong.

        A gap is an interval longer than 1.5 times the median one. Values that need more stamps than
        there are, are None.
        """
        typical = median(self._intervals) if self._intervals else None
        gaps = sum(interval > GAP_FACTOR * typical for interval in self._intervals) if typical else 0
        return {
            "messages": self.count,
            "start_ns": self._first if self.count else None,
            "duration_s": (self._latest - self._first) / NS_PER_S if self.count else None,
            "rate_hz": NS_PER_S / typical if typical else None,
            "largest_gap_s": max(self._intervals) / NS_PER_S if typical else None,
            "gaps": gaps,
            "stamps_not_later": self.not_later,
        }
