"""When frames were taken: clocks, regular intervals, drops."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from typing import Generic, TypeVar

from posetrack_cli.losses import LossLog
from posetrack_cli.recording.matching import LATEST_NS
from posetrack_cli.units import NS_PER_S

# One clock for the images of a topic: stamps that start at zero, or whose clock is set or reset.
#
# Messages carry the camera's stamp and the time at which they were logged. The camera's stamps count; where
# its clock fails, the difference of log times continues them, so that no image is lost. Images that are late
# or repeated keep their stamps, which are then not later than the one before, so that matching drops them.


Item = TypeVar("Item")

AHEAD = 3
"""Images whose stamps must go on from a stamp that went back, or it is a late image."""
LEAST_BACK_NS, BACK_INTERVALS = NS_PER_S, 10
"""A clock that goes back by less than both, or by fewer intervals, was not reset: images arrive late."""
LONGEST_GAP_NS = 3600 * NS_PER_S
"""A clock that goes on by more, while log times do not, was set."""
UNSTAMPED = 50
"""Images without a stamp from the beginning, from which on no image of the topic has one."""
USUAL_NS = NS_PER_S // 30
"""Time to the next image where neither clock states it."""


@dataclass(frozen=True)
class Timed(Generic[Item]):
    """An image with its times.

    Attributes:
        item: the image.
        own_ns: the camera's stamp; 0 for none, negative where there is no image, which keeps its place.
        log_ns: when it was logged.
    """

    item: Item
    own_ns: int
    log_ns: int


@dataclass
class Shifts:
    """By how much the cameras of one recording were shifted at each fault of their clock, ns.

    Cameras of one computer fail together: equal shifts keep images that were taken together together.
    """

    known: list[int] = field(default_factory=list)

    def of(self, number: int, shift_ns: int) -> int:
        """Return the shift at a camera's n-th fault: that of another camera if it is nearly the same."""
        if number < len(self.known):
            return self.known[number] if abs(self.known[number] - shift_ns) < NS_PER_S else shift_ns
        self.known.append(shift_ns)
        return shift_ns


class Clock(Generic[Item]):
    """Gives images stamps of one clock.

    Args:
        name: of the topic, for notes.
        losses: gets a note for each fault.
        shifts: shared by the cameras of a recording.
    """

    def __init__(self, name: str, losses: LossLog, shifts: Shifts | None = None) -> None:
        self._name, self._losses, self._shifts = name, losses, shifts or Shifts()
        self._shift, self._faults = 0, 0
        self._last: Timed[Item] | None = None
        self._latest = -1
        self._interval = 0
        self._waiting: deque[Timed[Item]] = deque()
        self._source: Iterator[Timed[Item]] = iter(())

    def stamped(self, images: Iterable[Timed[Item]]) -> Iterator[tuple[Item, int]]:
        """Yield each image with its stamp, ns; images are looked at in advance only where a clock fails."""
        self._source = iter(images)
        while (image := self._waiting.popleft() if self._waiting else next(self._source, None)) is not None:
            stamp = image.own_ns if image.own_ns < 0 else self._stamp(image)
            if self._latest < stamp <= LATEST_NS:
                if self._latest >= 0:
                    self._interval = stamp - self._latest
                self._latest, self._last = stamp, image
            yield image.item, stamp

    def _following(self, count: int) -> Iterator[Timed[Item]]:
        """Yield the images that come next, at most a number of them, without taking them."""
        for n in range(count):
            if n == len(self._waiting):
                image = next(self._source, None)
                if image is None:
                    return
                self._waiting.append(image)
            yield self._waiting[n]

    def _stamp(self, image: Timed[Item]) -> int:
        last = self._last
        if not image.own_ns:
            return self._unstamped(image)
        stamp = image.own_ns + self._shift
        if last is None or image.own_ns > LATEST_NS:
            return stamp
        if stamp <= self._latest:
            back = self._latest - stamp
            if back < LEAST_BACK_NS and back < BACK_INTERVALS * self._interval:
                return stamp
            if not self._goes_on(image):
                return stamp
            return self._shifted(image, last, f"is reset, back by {back / NS_PER_S:.3g} s")
        gap, logged = stamp - self._latest, image.log_ns - last.log_ns
        if gap > LONGEST_GAP_NS and logged < gap // 10 and last.log_ns != image.log_ns:
            return self._shifted(image, last, f"is set, forward by {gap / NS_PER_S:.3g} s")
        return stamp

    def _unstamped(self, image: Timed[Item]) -> int:
        """Continue, or begin, the camera's stamps by log times; without any, log times are the clock."""
        if self._last is not None:
            if abs(self._latest - self._last.log_ns) < NS_PER_S:  # the camera has the computer's clock
                return image.log_ns
            self._note("has images without a stamp: theirs continue by log times")
            return self._latest + self._step(image, self._last)
        first = next((each for each in self._following(UNSTAMPED) if each.own_ns > 0), None)
        if first is None or abs(first.own_ns - first.log_ns) < NS_PER_S:
            return image.log_ns
        stamp = first.own_ns - (first.log_ns - image.log_ns)
        if 0 <= stamp < first.own_ns:
            self._note("begins without a stamp: the first ones are by log times")
            return stamp
        return 0

    def _goes_on(self, image: Timed[Item]) -> bool:
        """Whether the stamps that follow go on from one that went back, as those of a reset clock do."""
        stamps = [image.own_ns, *(each.own_ns for each in self._following(AHEAD) if each.own_ns > 0)]
        rising = all(a < b for a, b in pairwise(stamps))
        return rising and len(stamps) > 1 and stamps[-1] + self._shift <= self._latest

    def _shifted(self, image: Timed[Item], last: Timed[Item], what: str) -> int:
        stamp = self._latest + self._step(image, last)
        self._shift = self._shifts.of(self._faults, stamp - image.own_ns)
        self._faults += 1
        self._note(f"{what}: stamps continue by log times")
        return max(image.own_ns + self._shift, self._latest + 1)

    def _step(self, image: Timed[Item], last: Timed[Item]) -> int:
        """Return the time between two images by their log times, or the usual one where those are equal."""
        logged = image.log_ns - last.log_ns
        return logged if 0 < logged < LONGEST_GAP_NS else self._interval or USUAL_NS

    def _note(self, what: str) -> None:
        self._losses.note(f"clock of {self._name} {what}")


# Rate, gaps and order of a sequence of stamps, and whether they can be meant.
#
# Seconds taken for nanoseconds, or a clock that jumped, spoil velocities.


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
