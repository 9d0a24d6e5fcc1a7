"""The light of a synthetic recording: two lamps and the light of the room, drifting slowly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.rendering.port import Lighting
from posetrack_cli.synthesis.head.options import HeadSynthOptions
from posetrack_cli.synthesis.head.smooth import Sway, minimum_jerk, random_sway

LAMPS = 2
STRENGTHS = np.array([0.52, 0.26])
AMBIENT, FROM_ABOVE = 0.46, np.array([0.0, -0.12, 0.0])
DRIFT = np.array([0.22, 0.3, 0.08, 0.25, 0.12])
"""How far lamps' strengths and the room's light (relative) and the first lamp's direction (rad) drift."""
DRIFT_HZ = (0.03, 0.12)
SWITCH_S, SWITCH_PART = 0.04, 0.5
SWITCHED = np.array([0.45, 1.9])
"""Factors on the lamps' strengths after the switch."""


@dataclass(frozen=True, eq=False)
class Illumination:
    """Light as a function of time.

    Attributes:
        directions: (L, 3) towards the lamps, reference axes.
        drift: of the lamps' strengths, the room's light, and the first lamp's two angles; None for none.
        switch_s: when the lamps' strengths change suddenly; None for never.
    """

    directions: FloatArray
    drift: Sway | None
    switch_s: float | None

    def at(self, seconds: float) -> Lighting:
        """The light at a time, s."""
        time = np.array([seconds])
        drift = np.zeros(5) if self.drift is None else self.drift(time)[0]
        strengths = STRENGTHS * (1.0 + drift[:2])
        if self.switch_s is not None:
            step = float(minimum_jerk((time - self.switch_s) / SWITCH_S)[0])
            strengths = strengths * (1.0 + step * (SWITCHED - 1.0))
        directions = self.directions.copy()
        directions[0, :2] += drift[3:]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return Lighting(directions, strengths, AMBIENT * (1.0 + float(drift[2])), FROM_ABOVE)


def make_illumination(options: HeadSynthOptions, rng: np.random.Generator) -> Illumination:
    """Draw where the lamps are and how they drift."""
    side = 1.0 if rng.random() < 0.5 else -1.0
    main = [side * rng.uniform(0.15, 0.6), -rng.uniform(0.4, 0.8), -1.0]
    fill = [-side * rng.uniform(0.5, 0.9), -rng.uniform(0.0, 0.4), -1.0]
    drift = random_sway(DRIFT, DRIFT_HZ, rng)
    return Illumination(
        np.array([main, fill]),
        None if options.light == "steady" else drift,
        SWITCH_PART * options.duration_s if options.light == "sudden" else None,
    )
