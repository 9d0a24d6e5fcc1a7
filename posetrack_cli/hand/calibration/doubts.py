"""What is doubtful about a hand's shape, in words, and what to do about it."""

from __future__ import annotations

from posetrack_cli.hand.calibration.calibrate import Calibration

HAND_LENGTHS_MM = (120.0, 225.0)
"""Of a child of three years, and of the largest men, wrist to tip."""
LARGEST_COEFFICIENT = 3.0
"""One hand in four hundred is farther from the mean in a coefficient."""
HARDLY_LEARNT = 0.8
"""A measure whose standard deviation is no less than this share of what it was before."""
_SHOWN = {
    "fingers' lengths": (("index_length", "middle_length", "ring_length", "little_length"), "the open hand"),
    "thumb": (("thumb_length",), "the thumb beside the open hand"),
    "palm": (("palm_length", "palm_width"), "the palm or the back of the hand"),
}


def doubts_of(found: Calibration) -> str:
    """Return what to add to a line about a hand; empty where nothing is doubtful."""
    length, (low, high) = found.length_mm, HAND_LENGTHS_MM
    if not low <= length <= high:
        return f", which no hand is ({low:.0f} to {high:.0f} mm): is the depth in mm (--depth-unit-mm)?"
    if max((abs(c) for c in found.shape.coefficients), default=0.0) > LARGEST_COEFFICIENT:
        return ", of proportions that hardly any hand has; posetrack view shows whether it fits"
    sd, prior = found.measured.sd, found.measured.prior_sd
    for what, (names, shown) in _SHOWN.items():
        if all(sd[name] > HARDLY_LEARNT * prior[name] for name in names):
            return f", its {what} hardly seen; record {shown} facing the sensor for a few seconds"
    return ""
