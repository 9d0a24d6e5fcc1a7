"""Whether stamps can be meant: seconds taken for nanoseconds, or a clock that jumped, spoil velocities."""

from __future__ import annotations

from posetrack_cli.units import NS_PER_S

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
