"""Hand shapes of natural motion, as finger angles."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.hand.model.anatomy import ANGLE_LIMITS, ANGLE_NAMES

_D = np.pi / 180.0
_STRAIGHT_THUMB, _OUT_THUMB = (-5.0, 5.0, 0.0), (-18.0, 2.0, 6.0)
_CURLED = (80.0, 0.0, 95.0)

# Degrees: thumb (CMC flexion, MCP flexion, CMC abduction), then index, middle, ring, little
# (MCP flexion, MCP abduction, PIP flexion). Thumbs touching a finger were computed for the average anatomy,
# so that the surfaces touch without intersecting.
_DEGREES: dict[str, tuple[tuple[float, float, float], ...]] = {
    "open": (_STRAIGHT_THUMB, (3.0, 5.0, 5.0), (3.0, 0.0, 5.0), (3.0, -4.0, 5.0), (4.0, -8.0, 6.0)),
    "spread": (_OUT_THUMB, (-3.0, 15.0, 4.0), (-2.0, 2.0, 4.0), (-3.0, -10.0, 4.0), (-4.0, -22.0, 4.0)),
    "relaxed": (
        (8.0, 15.0, 0.0),
        (22.0, 3.0, 28.0),
        (28.0, 0.0, 32.0),
        (32.0, -2.0, 34.0),
        (34.0, -5.0, 34.0),
    ),
    "fist": ((14.0, 48.0, -13.0), _CURLED, _CURLED, _CURLED, _CURLED),
    "one": ((28.0, 38.0, -15.0), (2.0, 2.0, 4.0), _CURLED, _CURLED, _CURLED),
    "two": ((41.0, 39.0, -15.0), (2.0, 12.0, 4.0), (2.0, -8.0, 4.0), _CURLED, _CURLED),
    "three": (
        (58.0, 26.0, -17.0),
        (2.0, 10.0, 4.0),
        (2.0, 0.0, 4.0),
        (3.0, -10.0, 5.0),
        (72.0, 0.0, 90.0),
    ),
    "four": ((30.0, 42.0, -15.0), (2.0, 7.0, 4.0), (2.0, 1.0, 4.0), (2.0, -5.0, 4.0), (3.0, -12.0, 5.0)),
    "pinch": (
        (17.0, 33.0, -8.0),
        (53.0, 0.0, 51.0),
        (38.0, 0.0, 45.0),
        (42.0, 0.0, 48.0),
        (44.0, 0.0, 48.0),
    ),
    "ok": ((17.0, 33.0, -8.0), (53.0, 0.0, 51.0), (12.0, 0.0, 14.0), (6.0, -5.0, 8.0), (2.0, -14.0, 5.0)),
    "point": ((28.0, 36.0, -16.0), (4.0, 0.0, 6.0), (78.0, 0.0, 92.0), _CURLED, _CURLED),
    "thumb": (_OUT_THUMB, _CURLED, _CURLED, _CURLED, _CURLED),
    "claw": ((5.0, 25.0, 0.0), (8.0, 6.0, 62.0), (8.0, 0.0, 64.0), (8.0, -5.0, 64.0), (8.0, -10.0, 60.0)),
}
THUMB_ACROSS = frozenset({"fist", "one", "two", "three", "four", "point"})
"""Shapes with the thumb in front of palm or fingers, where it obstructs moving fingers."""

SHAPES: dict[str, FloatArray] = {name: _D * np.ravel(rows) for name, rows in _DEGREES.items()}
"""(15,) finger angles of each shape, rad, all within the joint limits."""

LIMIT_MARGIN = 2.5 * _D
"""Margin to the joint limits, rad, which leaves room for the fingers' sway."""

FREE_FLEXION, STIFF_FLEXION = 5.0 * _D, 40.0 * _D
"""MCP flexion below which a finger abducts freely, and above which not at all, rad."""

_ABDUCTIONS = np.array([k for k, name in enumerate(ANGLE_NAMES) if k > 2 and name.endswith("abduction")])


def varied(shape: str, rng: np.random.Generator, sd: float = 3.0 * _D) -> FloatArray:
    """Return a shape's angles (15,), rad, with Gaussian variation, within the joint limits."""
    low, high = ANGLE_LIMITS.T
    angles = SHAPES[shape] + sd * rng.standard_normal(len(ANGLE_NAMES))
    return np.clip(angles, low + LIMIT_MARGIN, high - LIMIT_MARGIN)


def coupled(angles: FloatArray) -> FloatArray:
    """Reduce the abduction of flexed fingers: (T, 15) -> (T, 15).

    Abduction is multiplied by 1 - s(x), with s the minimum-jerk step and x from 0 at 5 degrees of MCP
    flexion to 1 at 40. Flexed fingers cannot be spread, as their collateral ligaments are taut.
    """
    out = angles.copy()
    bent = (angles[:, _ABDUCTIONS - 1] - FREE_FLEXION) / (STIFF_FLEXION - FREE_FLEXION)
    out[:, _ABDUCTIONS] *= 1.0 - minimum_jerk(bent)
    return out


def minimum_jerk(x: FloatArray) -> FloatArray:
    """Return the minimum-jerk step of x clipped to [0, 1] (Flash and Hogan 1985).

    s(x) = 10 x^3 - 15 x^4 + 6 x^5.
    """
    x = np.clip(x, 0.0, 1.0)
    return x * x * x * (10.0 - x * (15.0 - 6.0 * x))


def inside_limits(angles: FloatArray) -> BoolArray:
    """Return (T,) whether each row of angles (T, 15) is within the joint limits."""
    low, high = ANGLE_LIMITS.T
    return np.asarray(((angles >= low) & (angles <= high)).all(axis=1))
