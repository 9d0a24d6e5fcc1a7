"""When the frames of a video were taken, from the stamps that the video tells."""

from __future__ import annotations

MOST_BEHIND = 16
"""Frames in a row that may be earlier than the one before: as many as decoders hold back to put in order."""


class VideoStamps:
    """Turns the stamps that a video tells into stamps that increase, as far as the frames are in order.

    Behind damage a decoder may give out a frame that it had held back, long after its time. Such a frame
    keeps its stamp, which is then not later than the one before: it is out of place, and whoever takes the
    frames leaves it out. Where stamps begin anew, as in files that were put together, they go on.

    Args:
        period_ns: time between frames where no stamp tells it, above 0.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = max(period_ns, 1)
        self._latest: int | None = None
        self._offset, self._behind = 0, 0

    def stamp(self, told_ns: int) -> int:
        """Return the stamp, ns, of the frame that the video says was taken at ``told_ns``, 0 where untold."""
        if self._latest is None:
            self._offset = max(-told_ns, 0)
        elif told_ns + self._offset <= self._latest:
            if told_ns > 0 and self._behind < MOST_BEHIND:
                self._behind += 1
                return told_ns + self._offset
            self._offset = self._latest + self._period_ns - told_ns
        self._behind = 0
        self._latest = told_ns + self._offset
        return self._latest
