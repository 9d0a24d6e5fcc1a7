"""When the frames of a synthetic recording are taken, and which frames or images are missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray

START_NS = 1_000_000_000
"""Stamp of the first frame: not 0, which some readers take for "no stamp"."""

DROP_PROBABILITY = 0.02
BURST_SHARE = 0.2
"""Share of the drops that take 2 to 4 frames at once."""

LATE_PROBABILITY = 0.1
LATE_S = (0.002, 0.015)
MOST_LATE = 0.45
"""A frame is late by at most this part of the frame interval, so that order is kept at any rate."""

BURSTS_PER_FRAME, LONGEST_BURST = 0.01, 12
"""Of images that one camera misses: a burst takes 1 to so many."""


@dataclass(frozen=True)
class Timeline:
    """The instants of a recording.

    Attributes:
        stamps_ns: (T,) when each frame is taken, strictly increasing; also of the dropped ones.
        dropped: (T,) which frames are missing, or (C, T) which image of each camera; never the first.
    """

    stamps_ns: IntArray
    dropped: BoolArray

    @property
    def seconds(self) -> FloatArray:
        """(T,) time since the first frame, s."""
        return np.asarray((self.stamps_ns - self.stamps_ns[0]) * 1e-9, dtype=np.float64)


def make_timeline(frames: int, fps: float, *, drops: bool, late: bool, rng: np.random.Generator) -> Timeline:
    """Return the instants of a recording.

    Each frame is dropped with probability ``DROP_PROBABILITY`` / (mean burst length), which begins a
    burst of 2 to 4 in one case of five; each is late with probability ``LATE_PROBABILITY`` by a time
    uniform in ``LATE_S``.

    Args:
        frames: number of instants.
        fps: nominal rate, Hz.
        drops: whether frames are dropped.
        late: whether frames are late.
        rng: draws the same numbers whatever the switches are.
    """
    delays = _delays(frames, fps, rng)
    dropped = _dropped(frames, rng)
    nominal = nominal_stamps(frames, fps)
    stamps = nominal + np.rint(delays * 1e9).astype(np.int64) if late else nominal
    return Timeline(stamps, dropped if drops else np.zeros(frames, dtype=np.bool_))


def nominal_stamps(frames: int, fps: float) -> IntArray:
    """Return the stamps (T,) ns of frames that are all on time, at a rate in Hz."""
    since = np.rint(np.arange(frames) * (1e9 / fps)).astype(np.int64)
    return np.asarray(START_NS + since, dtype=np.int64)


def _delays(frames: int, fps: float, rng: np.random.Generator) -> FloatArray:
    chosen = rng.random(frames) < LATE_PROBABILITY
    delays = np.where(chosen, rng.uniform(*LATE_S, frames), 0.0)
    delays[0] = 0.0
    return np.minimum(delays, MOST_LATE / fps)


def _dropped(frames: int, rng: np.random.Generator) -> BoolArray:
    lengths = np.where(rng.random(frames) < BURST_SHARE, rng.integers(2, 5, frames), 1)
    mean_length = 1.0 + 2.0 * BURST_SHARE
    begins = rng.random(frames) < DROP_PROBABILITY / mean_length
    dropped = np.zeros(frames, dtype=np.bool_)
    for first in np.flatnonzero(begins):
        dropped[first : first + lengths[first]] = True
    dropped[0] = False
    return dropped


def dropped_images(cameras: int, frames: int, rng: np.random.Generator) -> BoolArray:
    """Return which images (C, T) are missing: never of the first frame, never all of a frame of several."""
    dropped = np.zeros((cameras, frames), dtype=np.bool_)
    for row in dropped:
        for first in np.flatnonzero(rng.random(frames) < BURSTS_PER_FRAME):
            row[first : first + rng.integers(1, LONGEST_BURST + 1)] = True
    dropped[:, 0] = False
    if cameras > 1:
        dropped[0, dropped.all(axis=0)] = False
    return dropped
