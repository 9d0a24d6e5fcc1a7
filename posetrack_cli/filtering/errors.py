"""The one error of filters, and the check of a time step that every prediction makes."""

from __future__ import annotations

import math

from posetrack_cli.errors import PosetrackError


class FilterError(PosetrackError):
    """A filter was given what it cannot work with: weights without mass, NaN, or a time step that is none."""


def check_time_step(dt: float) -> None:
    """Raise FilterError unless dt, seconds, is finite and > 0."""
    if not (math.isfinite(dt) and dt > 0.0):
        raise FilterError(
            "time does not move forward",
            found=f"dt {dt} s",
            expected="a finite dt > 0",
            hint="are the frames sorted by their stamps?",
        )
