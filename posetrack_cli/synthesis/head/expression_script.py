"""When a synthetic face makes which expression: the pattern of the thesis's experiment 3.4, or another.

After a neutral beginning it deforms until two thirds of the recording are over, then only the head moves; or
it makes the two motions that models of faces are built from: the mouth grows wide and narrow, then the whole
face long and short, brows and jaw together, each swept through its range several times, slowly. Blinks and
small movements of the eyes go on throughout.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.synthesis.head.expressions import EXPRESSIONS
from posetrack_cli.synthesis.head.options import TWO_MOTIONS, HeadSynthOptions
from posetrack_cli.synthesis.head.smooth import minimum_jerk, pulse

NEUTRAL_S, NEUTRAL_PART = 2.0, 0.15
"""The neutral beginning: so long, but at most this part of the recording."""
DEFORMING_PART = 2.0 / 3.0
RISE_S, HOLD_S, FALL_S, REST_S = (0.25, 0.6), (0.2, 1.0), (0.25, 0.6), (0.0, 0.4)
BLINK_EVERY_S, BLINK_S = (2.5, 6.0), (0.06, 0.02, 0.10)
GAZE_EVERY_S, GAZE_MOVE_S, GAZE = (0.8, 3.0), 0.06, 0.5
# what is made together, with the least and greatest strength
_FACES: tuple[dict[str, tuple[float, float]], ...] = (
    {"jaw_open": (0.4, 0.9)},
    {"jaw_open": (0.3, 0.6), "brows_up": (0.5, 1.0)},
    {"smile_right": (0.5, 0.9), "smile_left": (0.5, 0.9)},
    {"smile_right": (0.4, 0.8), "smile_left": (0.4, 0.8), "jaw_open": (0.1, 0.3)},
    {"smile_left": (0.5, 0.9)},
    {"smile_right": (0.5, 0.9)},
    {"mouth_sideways": (0.5, 0.9)},
    {"mouth_sideways": (-0.9, -0.5)},
    {"pucker": (0.5, 1.0)},
    {"brows_up": (0.6, 1.0)},
    {"brows_down": (0.6, 1.0), "pucker": (0.0, 0.4)},
)

# The two motions that models of faces are built from (thesis, 4.2 and figure 4.4)
STILL_S, STILL_PART = 4.5, 0.3
"""The neutral beginning, in which a tracker takes the face for rigid: so long, but at most this part."""
SWEEP_S, LEAST_SWEEPS = 3.0, 2
"""[ours] Each motion is swept through in about this time, so many times at least."""
HOLD_PART = 0.1
"""Of a sweep, in which either end of the range is held."""
STRENGTH = (0.8, 1.0)
# what is made together, the one way and the other
_WIDTH = (("smile_right", "smile_left"), ("pucker",))
_LENGTH = (("jaw_open", "brows_up"), ("brows_down",))


@dataclass(frozen=True)
class Episode:
    """One expression: its name, greatest strength, begin, and how long it rises, stays and falls, s."""

    name: str
    strength: float
    start: float
    rise: float
    hold: float
    fall: float

    @property
    def end(self) -> float:
        """When it is over, s."""
        return self.start + self.rise + self.hold + self.fall


@dataclass(frozen=True, eq=False)
class ExpressionScript:
    """All expressions of a recording.

    Attributes:
        episodes: in any order; strengths of the same name add up.
        gazes: (G, 2) when the eyes move, s, and where to, -1 to 1.
    """

    episodes: tuple[Episode, ...]
    gazes: FloatArray

    def strengths(self, times: FloatArray) -> FloatArray:
        """Strengths (T, J) of ``EXPRESSIONS`` at times (T,), s."""
        values = np.zeros((len(times), len(EXPRESSIONS)))
        for one in self.episodes:
            shape = pulse(times, one.start, one.rise, one.hold, one.fall)
            values[:, EXPRESSIONS.index(one.name)] += one.strength * shape
        values[:, EXPRESSIONS.index("gaze")] = self._gaze(times)
        return values

    def _gaze(self, times: FloatArray) -> FloatArray:
        gaze, before = np.zeros(len(times)), 0.0
        for start, target in self.gazes:
            gaze += (target - before) * minimum_jerk((times - start) / GAZE_MOVE_S)
            before = target
        return gaze


def make_script(options: HeadSynthOptions, rng: np.random.Generator) -> ExpressionScript:
    """Draw the expressions of a recording; without expressions the face keeps quite still."""
    if not options.expressions:
        return ExpressionScript((), np.zeros((0, 2)))
    deforming, blinking, looking = rng.spawn(3)
    duration_s = options.duration_s
    drawn = two_motions if options.script == TWO_MOTIONS else _deformations
    episodes = [*drawn(duration_s, deforming), *_blinks(duration_s, blinking)]
    return ExpressionScript(tuple(episodes), _gazes(duration_s, looking))


def deforming_interval(options: HeadSynthOptions) -> tuple[float, float] | None:
    """Return from when until when a face deforms, s; None for never."""
    if not options.expressions:
        return None
    of_script = motions_interval if options.script == TWO_MOTIONS else _free_interval
    return of_script(options.duration_s)


def _free_interval(duration_s: float) -> tuple[float, float]:
    return min(NEUTRAL_S, NEUTRAL_PART * duration_s), DEFORMING_PART * duration_s


def _deformations(duration_s: float, rng: np.random.Generator) -> list[Episode]:
    time, end = _free_interval(duration_s)
    order: list[int] = []
    episodes: list[Episode] = []
    while True:
        order = order or rng.permutation(len(_FACES)).tolist()
        rise, hold, fall = (float(rng.uniform(*limits)) for limits in (RISE_S, HOLD_S, FALL_S))
        if time + rise + hold + fall > end:
            return episodes
        for name, limits in _FACES[order.pop()].items():
            episodes.append(Episode(name, float(rng.uniform(*limits)), time, rise, hold, fall))
        time += rise + hold + fall + float(rng.uniform(*REST_S))


def _blinks(duration_s: float, rng: np.random.Generator) -> list[Episode]:
    time, episodes = float(rng.uniform(*BLINK_EVERY_S)), []
    while time < duration_s:
        episodes.append(Episode("blink", 1.0, time, *BLINK_S))
        time += float(rng.uniform(*BLINK_EVERY_S))
    return episodes


def _gazes(duration_s: float, rng: np.random.Generator) -> FloatArray:
    time, gazes = float(rng.uniform(*GAZE_EVERY_S)), []
    while time < duration_s:
        gazes.append((time, float(rng.uniform(-GAZE, GAZE))))
        time += float(rng.uniform(*GAZE_EVERY_S))
    return np.array(gazes, dtype=np.float64).reshape(-1, 2)


def two_motions(duration_s: float, rng: np.random.Generator) -> tuple[Episode, ...]:
    """Return the expressions of a recording of so many seconds."""
    start, end = motions_interval(duration_s)
    half = 0.5 * (end - start)
    return (*_sweeps(_WIDTH, start, half, rng), *_sweeps(_LENGTH, start + half, half, rng))


def motions_interval(duration_s: float) -> tuple[float, float]:
    """Return from when until when the face moves, s."""
    return min(STILL_S, STILL_PART * duration_s), duration_s


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
