"""The order in which the frames of a track are written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.errors import ResultError


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
