"""Timing of frames: clock faults, intervals, gaps."""

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

# One clock for the images of a topic
#
# Messages carry the camera's stamp and a log time. The camera's stamps are used; where its clock is missing,
# set or reset, log time differences continue them, so that no image is lost. Late or repeated images keep
# their stamps and are dropped by matching.


Item = TypeVar("Item")

# Images whose stamps must continue from a stamp that went back; otherwise it is a late image.
AHEAD = 3
# A step back below both limits (the second in intervals) is not a clock reset: images arrive late.
LEAST_BACK_NS, BACK_INTERVALS = NS_PER_S, 10
LONGEST_GAP_NS = 3600 * NS_PER_S  # a larger step that log times do not show means that the clock was set
# If this many initial images have no stamp, the topic has none.
UNSTAMPED = 50
USUAL_NS = NS_PER_S // 30  # interval if neither clock gives one


@dataclass(frozen=True)
class Timed(Generic[Item]):
    """An image with its times.

    Attributes:
        item: the image.
        own_ns: the camera's stamp; 0 for none, negative for a missing image that keeps its index.
        log_ns: log time.
    """

    item: Item
    own_ns: int
    log_ns: int


@dataclass
class Shifts:
    """Clock shifts of the cameras of one recording, one per clock fault, ns.

    Cameras of one computer fail together; sharing the shift keeps simultaneous images matched.
    """

    known: list[int] = field(default_factory=list)

    def of(self, number: int, shift_ns: int) -> int:
        """Return the shift at a camera's n-th fault: another camera's if nearly equal."""
        if number < len(self.known):
            return self.known[number] if abs(self.known[number] - shift_ns) < NS_PER_S else shift_ns
        self.known.append(shift_ns)
        return shift_ns


class Clock(Generic[Item]):
    """Puts the stamps of images on one clock.

    Args:
        name: topic, for notes.
        losses: receives a note for each fault.
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
        """Yield each image with its stamp, ns; looks ahead only where a clock fails."""
        self._source = iter(images)
        while (image := self._waiting.popleft() if self._waiting else next(self._source, None)) is not None:
            stamp = image.own_ns if image.own_ns < 0 else self._stamp(image)
            if self._latest < stamp <= LATEST_NS:
                if self._latest >= 0:
                    self._interval = stamp - self._latest
                self._latest, self._last = stamp, image
            yield image.item, stamp

    def _following(self, count: int) -> Iterator[Timed[Item]]:
        """Yield the next images, at most ``count``, without consuming them."""
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
            if not self._continues(image):
                return stamp
            return self._shifted(image, last, f"was reset, back by {back / NS_PER_S:.3g} s")
        gap, logged = stamp - self._latest, image.log_ns - last.log_ns
        if gap > LONGEST_GAP_NS and logged < gap // 10 and last.log_ns != image.log_ns:
            return self._shifted(image, last, f"was set, forward by {gap / NS_PER_S:.3g} s")
        return stamp

    def _unstamped(self, image: Timed[Item]) -> int:
        """Return a stamp from log times, continuing the camera's stamps if there are any."""
        if self._last is not None:
            if abs(self._latest - self._last.log_ns) < NS_PER_S:  # the camera uses the computer's clock
                return image.log_ns
            self._note("missing in some images: stamps continued by log times")
            return self._latest + self._step(image, self._last)
        first = next((each for each in self._following(UNSTAMPED) if each.own_ns > 0), None)
        if first is None or abs(first.own_ns - first.log_ns) < NS_PER_S:
            return image.log_ns
        stamp = first.own_ns - (first.log_ns - image.log_ns)
        if 0 <= stamp < first.own_ns:
            self._note("missing in the first images: stamps extrapolated by log times")
            return stamp
        return 0

    def _continues(self, image: Timed[Item]) -> bool:
        """Return whether the next stamps continue from one that went back, as after a clock reset."""
        stamps = [image.own_ns, *(each.own_ns for each in self._following(AHEAD) if each.own_ns > 0)]
        rising = all(a < b for a, b in pairwise(stamps))
        return rising and len(stamps) > 1 and stamps[-1] + self._shift <= self._latest

    def _shifted(self, image: Timed[Item], last: Timed[Item], what: str) -> int:
        stamp = self._latest + self._step(image, last)
        self._shift = self._shifts.of(self._faults, stamp - image.own_ns)
        self._faults += 1
        self._note(f"{what}: stamps continued by log times")
        return max(image.own_ns + self._shift, self._latest + 1)

    def _step(self, image: Timed[Item], last: Timed[Item]) -> int:
        """Return the log time between two images, or the latest interval if log times are equal."""
        logged = image.log_ns - last.log_ns
        return logged if 0 < logged < LONGEST_GAP_NS else self._interval or USUAL_NS

    def _note(self, what: str) -> None:
        self._losses.note(f"clock of {self._name} {what}")


# Plausibility of stamps: a wrong unit or a clock jump ruins velocities
# An interval longer than this many median intervals is a gap.
GAP_FACTOR = 1.5
LONGEST_NS = 2**64 - 1
# Above any tracked camera: depth cameras reach 300 frames/s, high-speed ones 1000. Stamps in s, ms or us
# read as ns give rates at least a thousand times too high.
FASTEST_HZ = 2000.0
SLOWEST_S = 10.0  # motion cannot be followed at longer intervals
# A gap of an hour, or of a minute and 100 intervals, means that the clock was set.
LONGEST_GAP_S, LONG_GAP_S, LONG_GAP_FACTOR = 3600.0, 60.0, 100.0


class StampCheck:
    """Streaming plausibility check of stamps, in constant memory."""

    def __init__(self) -> None:
        self._first: tuple[int, int] | None = None
        self._last = (0, 0)
        self._gap_ns, self._gap_frames, self._gap_at = 0, 0, 0

    def add(self, index: int, stamp_ns: int) -> None:
        """Add a frame's index and stamp, ns; both must increase."""
        if self._first is None:
            self._first = (index, stamp_ns)
        elif stamp_ns - self._last[1] > self._gap_ns:
            self._gap_ns, self._gap_frames = stamp_ns - self._last[1], index - self._last[0]
            self._gap_at = index
        self._last = (index, stamp_ns)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on implausible stamps, one line each; () if there are none."""
        if self._first is None or self._last == self._first:
            return ()
        frames, ns = self._last[0] - self._first[0], self._last[1] - self._first[1]
        rest = frames - self._gap_frames
        usual_s = ((ns - self._gap_ns) / rest if rest > 0 else ns / frames) / NS_PER_S
        said = []
        if usual_s * FASTEST_HZ < 1.0:
            rate = f"{1.0 / usual_s:.3g}" if usual_s > 0.0 else "infinitely many"
            said.append(f"stamps give {rate} frames/s, faster than any camera: are they in nanoseconds?")
        elif usual_s > SLOWEST_S:
            said.append(f"stamps give a frame every {usual_s:.3g} s: are they in nanoseconds?")
        gap_s = self._gap_ns / NS_PER_S
        alone = rest > 0 and gap_s > LONG_GAP_S and gap_s > LONG_GAP_FACTOR * usual_s * self._gap_frames
        if alone or (gap_s >= LONGEST_GAP_S and usual_s <= SLOWEST_S):
            said.append(f"gap of {gap_s:.6g} s before frame {self._gap_at}: was the clock set?")
        return tuple(said)


class Timeline:
    """Stamps collected one by one, 8 bytes each.

    Attributes:
        count: number of stamps.
        not_later: stamps not later than the latest before them; readers drop these frames.
    """

    def __init__(self) -> None:
        self.count = 0
        self.not_later = 0
        self._first = 0
        self._latest = 0
        self._intervals = array("Q")
        self._check = StampCheck()

    def add(self, stamp_ns: int) -> None:
        """Add the next stamp, ns."""
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
        """Remarks on implausible stamps, if they are frames', one line each."""
        return self._check.remarks

    def summary(self) -> dict[str, int | float | None]:
        """Return start, duration, median rate, largest gap, and numbers of gaps and late stamps.

        A gap is an interval longer than 1.5 times the median. Values that need more stamps are None.
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
