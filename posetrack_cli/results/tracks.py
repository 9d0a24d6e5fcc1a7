"""The tracks that a result may hold: what they are called, where they lie, and the order of their frames."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.errors import ResultError

FILTERED = "filtered"
"""Each estimate rests on the frames up to its own."""
SMOOTHED = "smoothed"
"""Each estimate rests on all frames of the recording."""
TRACKS = (FILTERED, SMOOTHED)

SMOOTHED_PREFIX = f"/{SMOOTHED}/"
TRANSFORMS_TOPIC = "/tf"
SMOOTHED_TRANSFORMS_TOPIC = f"{SMOOTHED_PREFIX}tf"


def topics_prefix(subject: str, track: str) -> str:
    """Return what the topics of a subject's track begin with: ``/hand``, ``/smoothed/hand``.

    Raises:
        ResultError: there is no such track.
    """
    if track not in TRACKS:
        raise ResultError("no such track", found=repr(track), expected=" or ".join(TRACKS))
    return f"/{subject}" if track == FILTERED else f"{SMOOTHED_PREFIX}{subject}"


def estimate_topic(subject: str, track: str = FILTERED) -> str:
    """Return the topic of a track's complete estimates."""
    return f"{topics_prefix(subject, track)}/estimate"


def body_frame(subject: str, track: str = FILTERED) -> str:
    """Return the frame id of a track's body: two bodies of one file must not share theirs."""
    return subject if track == FILTERED else f"{subject}_{track}"


@dataclass
class StampOrder:
    """Which way the stamps of a track go: up, or down as a backward pass makes them."""

    count: int = 0
    _last_ns: int = 0
    _direction: int = 0  # 1 up, -1 down, 0 not known yet

    def check(self, stamp_ns: int, where: Path) -> None:
        """Raise ResultError unless the stamp goes on as those before."""
        step = stamp_ns - self._last_ns
        if self.count and (step == 0 or step * self._direction < 0):
            found, expected = (
                f"{stamp_ns} ns after {self._last_ns} ns",
                "each frame once, in order or in reverse",
            )
            raise ResultError("smoothed frames are out of order", where=where, found=found, expected=expected)

    def add(self, stamp_ns: int) -> None:
        """Count a stamp."""
        if self.count:
            self._direction = 1 if stamp_ns > self._last_ns else -1
        self.count, self._last_ns = self.count + 1, stamp_ns
