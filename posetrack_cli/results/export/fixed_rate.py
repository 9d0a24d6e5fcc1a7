"""Estimates as frames of a fixed rate, for formats that know no other times.

Stamps jitter, frames are dropped, tracks are left out while they are lost: frame i is what was estimated
nearest to the time ``i / rate`` after the first estimate, or nothing if that is more than half a frame off.
So times are right to half a frame over the whole recording, and no frame is told twice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import ResultError
from posetrack_cli.units import NS_PER_S

SINGLE_HZ = 30.0
"""Rate that is stated of a single frame, which has none."""


@dataclass(frozen=True, eq=False)
class FixedRate:
    """Which estimate each frame is.

    Attributes:
        rate_hz: of the frames.
        rows: (F,) row of each frame's estimate; -1 where there is none.
        estimates: how many there were.
    """

    rate_hz: float
    rows: IntArray
    estimates: int

    @property
    def known(self) -> BoolArray:
        """(F,) whether there is an estimate."""
        return self.rows >= 0

    def notes(self, filled: str) -> Iterator[str]:
        """Yield what a user must know: frames without estimate, which are ``filled``; estimates left out."""
        empty = int(np.sum(~self.known))
        left_out = self.estimates - (len(self.rows) - empty)
        if empty:
            yield f"{empty} of {len(self.rows)} frames at {self.rate_hz:.6g} Hz have no estimate: {filled}"
        if left_out:
            yield f"{left_out} of {self.estimates} estimates left out: nearer than a frame to others"


def fixed_rate(stamps_ns: IntArray, where: str) -> FixedRate:
    """Return frames of the rate that stamps (N,) have on the whole.

    The median step tells how many frames lie between neighbours, and all of them together the rate: that of a
    30 Hz camera whose stamps are whole milliseconds is 30 Hz.

    Raises:
        ResultError: there is no stamp, or the gaps are too long for what there is.
    """
    if not len(stamps_ns):
        raise ResultError("holds no estimate", where=where)
    order = np.argsort(stamps_ns, kind="stable")
    since = stamps_ns[order] - stamps_ns[order[0]]
    steps = np.diff(since)
    steps = steps[steps > 0]
    if not len(steps):
        return FixedRate(SINGLE_HZ, order[:1], len(stamps_ns))
    step_ns = since[-1] / float(np.sum(np.rint(steps / np.median(steps))))
    places = since / step_ns
    count = round(float(places[-1])) + 1
    most = max(limits.EXPORT_FRAMES, limits.EXPORT_EXPANSION * len(stamps_ns))
    if count > most:
        raise ResultError(
            "gaps are too long for a format of fixed frame rate",
            where=where,
            found=f"{count} frames at {NS_PER_S / step_ns:.6g} Hz for {len(stamps_ns)} estimates",
            expected=f"{most} at most",
            hint="csv, json and npz state every estimate's time",
        )
    return FixedRate(NS_PER_S / step_ns, _nearest(places, order, count), len(stamps_ns))


def _nearest(places: FloatArray, order: IntArray, count: int) -> IntArray:
    """The row of the place nearest to each whole number, -1 where none is within a half."""
    frames = np.rint(places).astype(np.int64)
    off = np.abs(places - frames)
    rows = np.full(count, -1, dtype=np.int64)
    farthest_first = np.argsort(-off, kind="stable")
    rows[frames[farthest_first]] = order[farthest_first]  # of several the last one that is assigned stays
    return rows
