"""The two motions that models of faces are built from (thesis, 4.2 and figure 4.4).

After a neutral beginning the mouth grows wide and narrow, then the whole face grows long and short, brows and
jaw together: each swept through its range several times, slowly.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from posetrack_cli.synthesis.head.episode import Episode

NEUTRAL_S, NEUTRAL_PART = 4.5, 0.3
"""The neutral beginning, in which a tracker takes the face for rigid: so long, but at most this part."""
SWEEP_S, LEAST_SWEEPS = 3.0, 2
"""[ours] Each motion is swept through in about this time, so many times at least."""
HOLD_PART = 0.1
"""Of a sweep, in which either end of the range is held."""
STRENGTH = (0.8, 1.0)
# what is made together, the one way and the other
_WIDTH = (("smile_right", "smile_left"), ("pucker",))
_LENGTH = (("jaw_open", "brows_up"), ("brows_down",))


def two_motions(duration_s: float, rng: np.random.Generator) -> tuple[Episode, ...]:
    """Return the expressions of a recording of so many seconds."""
    start, end = motions_interval(duration_s)
    half = 0.5 * (end - start)
    return (*_sweeps(_WIDTH, start, half, rng), *_sweeps(_LENGTH, start + half, half, rng))


def motions_interval(duration_s: float) -> tuple[float, float]:
    """Return from when until when the face moves, s."""
    return min(NEUTRAL_S, NEUTRAL_PART * duration_s), duration_s


def _sweeps(
    motion: tuple[tuple[str, ...], ...], start: float, length: float, rng: np.random.Generator
) -> Iterator[Episode]:
    """One motion to and fro in a time: a sweep goes one way and back, then the other way and back."""
    count = max(LEAST_SWEEPS, round(length / SWEEP_S))
    time, part = start, length / (count * len(motion))
    hold = HOLD_PART * part
    way = 0.5 * (part - hold)
    for _ in range(count):
        for together in motion:
            strength = float(rng.uniform(*STRENGTH))
            for name in together:
                yield Episode(name, strength, time, way, hold, way)
            time += part
