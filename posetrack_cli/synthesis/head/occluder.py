"""When and where an object passes before the face: it comes from the side, covers one half, and leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.synthesis.head.curves import pulse
from posetrack_cli.synthesis.head.options import HeadSynthOptions

OCCLUDED_PART = 0.45
"""Part of the recording at which the object has come."""
COME_S, STAY_S = 0.35, 1.0
AWAY_MM, COVERING_MM, BEFORE_MM = 520.0, 52.0, 150.0
"""Distance of the object's middle from the head's: sideways when away and when covering, towards the
camera."""


@dataclass(frozen=True)
class Occluder:
    """An object's way: it covers half of the face from ``start_s``; side 1 is the image's right."""

    start_s: float
    side: float

    @property
    def interval(self) -> tuple[float, float]:
        """From when until when any of the face may be covered, s."""
        return self.start_s - COME_S, self.start_s + STAY_S + COME_S

    def place(self, seconds: float, head: FloatArray) -> FloatArray:
        """The middle (3,) of the object, mm, reference axes, when the head is at (3,)."""
        near = float(pulse(np.array([seconds]), self.start_s - COME_S, COME_S, STAY_S, COME_S)[0])
        aside = AWAY_MM * head[2] / 700.0 + near * (COVERING_MM - AWAY_MM * head[2] / 700.0)
        place: FloatArray = head + np.array([self.side * aside, 0.0, -BEFORE_MM])
        return place


def make_occluder(options: HeadSynthOptions, rng: np.random.Generator) -> Occluder | None:
    """Return the object's way, None without an object; the side is drawn in any case."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    return Occluder(OCCLUDED_PART * options.duration_s, side) if options.occlusion else None
