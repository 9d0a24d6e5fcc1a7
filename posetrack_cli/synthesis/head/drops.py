"""Images that a camera misses while another one takes its own."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray

BURSTS_PER_FRAME = 0.01
LONGEST = 12
"""Bursts last 1 to so many frames."""


def dropped_images(cameras: int, frames: int, rng: np.random.Generator) -> BoolArray:
    """Return which images (C, T) are missing: never of the first frame, never all of a frame of several."""
    dropped = np.zeros((cameras, frames), dtype=np.bool_)
    for row in dropped:
        for first in np.flatnonzero(rng.random(frames) < BURSTS_PER_FRAME):
            row[first : first + rng.integers(1, LONGEST + 1)] = True
    dropped[:, 0] = False
    if cameras > 1:
        dropped[0, dropped.all(axis=0)] = False
    return dropped
