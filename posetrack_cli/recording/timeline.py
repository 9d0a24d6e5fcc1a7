"""Rate, gaps and order of a sequence of stamps, and whether they can be meant.

Seconds taken for nanoseconds, or a clock that jumped, spoil velocities.
"""

from __future__ import annotations

from array import array
from statistics import median

from posetrack_cli.units import NS_PER_S

GAP_FACTOR = 1.5
"""An interval that is longer than this many usual ones lacks a frame."""
LONGEST_NS = 2**64 - 1
FASTEST_HZ = 2000.0
"""No camera whose images are tracked is faster: depth cameras reach 300 frames/s, high-speed ones 1000.

Stamps in seconds, milliseconds or microseconds that are taken for nanoseconds are a thousand times faster.
"""
SLOWEST_S = 10.0
"""A frame in so long a time is not what a motion can be followed by."""
LONGEST_GAP_S, LONG_GAP_S, LONG_GAP_FACTOR = 3600.0, 60.0, 100.0
"""A gap of an hour, or of a minute if that is so many times the usual interval, is a clock that was set."""


class StampCheck:
    """Looks at stamps one by one, and remembers few of them however many there are."""

    def __init__(self) -> None:
        self._first: tuple[int, int] | None = None
        self._last = (0, 0)
        self._gap_ns, self._gap_frames, self._gap_at = 0, 0, 0

    def add(self, index: int, stamp_ns: int) -> None:
        """Take a frame's position in the recording and its stamp, ns; both are later than those before."""
        if self._first is None:
            self._first = (index, stamp_ns)
        elif stamp_ns - self._last[1] > self._gap_ns:
            self._gap_ns, self._gap_frames = stamp_ns - self._last[1], index - self._last[0]
            self._gap_at = index
        self._last = (index, stamp_ns)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What cannot be meant, one line each; () where nothing is to be said."""
        if self._first is None or self._last == self._first:
            return ()
        frames, ns = self._last[0] - self._first[0], self._last[1] - self._first[1]
        rest = frames - self._gap_frames
        usual_s = ((ns - self._gap_ns) / rest if rest > 0 else ns / frames) / NS_PER_S
        said = []
        if usual_s * FASTEST_HZ < 1.0:
            rate = f"{1.0 / usual_s:.3g}" if usual_s > 0.0 else "no end of"
            said.append(f"{rate} frames/s by their stamps, faster than any camera: are they nanoseconds?")
        elif usual_s > SLOWEST_S:
            said.append(f"a frame every {usual_s:.3g} s by their stamps: are they nanoseconds?")
        gap_s = self._gap_ns / NS_PER_S
        alone = rest > 0 and gap_s > LONG_GAP_S and gap_s > LONG_GAP_FACTOR * usual_s * self._gap_frames
        if alone or (gap_s >= LONGEST_GAP_S and usual_s <= SLOWEST_S):
            said.append(f"a gap of {gap_s:.6g} s before frame {self._gap_at}: was the clock set?")
        return tuple(said)


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
