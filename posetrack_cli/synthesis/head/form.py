"""The form of an average head of our own making, in coordinates that every head shares.

A place on it is an angle phi about the vertical axis (0 in front, positive to the subject's left) and a
level, which is the height y up to the forehead and goes on along the skull to its top. What is painted or
moved is said in the average head's own x and y, as seen from in front.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray

AXIS_Z = -82.0
"""Depth of the vertical axis, mm: between the ears."""
DOME, DOME_RADIUS = 60.0, 62.0
TOP, BOTTOM = DOME + DOME_RADIUS * np.pi / 2.0, -210.0
"""Levels of the top of the skull and of the neck's lower end, mm."""
MOUTH_Y = -68.7
"""Height of the line between the lips."""
MOUTH_X = 25.4
"""Half the distance between the mouth's corners."""

# level: half width, front, back, mm, from a person's proportions; then how pointed the front is
_PROFILE = np.array(
    [
        (-210.0, 56.0, -24.0, -136.0, 1.0),
        (-160.0, 49.0, -34.0, -132.0, 1.0),
        (-138.0, 47.0, -39.0, -130.0, 1.0),
        (-127.0, 47.0, -31.0, -130.0, 1.1),
        (-120.0, 48.0, -11.0, -131.0, 1.35),
        (-114.0, 50.0, 5.0, -132.0, 1.5),
        (-105.0, 53.0, 12.5, -135.0, 1.5),
        (-92.0, 57.0, 11.0, -140.0, 1.35),
        (-70.0, 62.5, 15.0, -150.0, 1.15),
        (-50.0, 67.0, 17.0, -162.0, 1.05),
        (-25.0, 71.0, 14.0, -172.0, 1.0),
        (0.0, 73.0, 9.0, -180.0, 1.0),
        (25.0, 73.0, 19.0, -185.0, 1.0),
        (45.0, 72.5, 21.0, -186.0, 1.0),
        (DOME, 71.0, 19.5, -185.0, 1.0),
    ]
)


def height(level: FloatArray) -> FloatArray:
    """Return the height y (...), mm, of a level."""
    over = np.clip((level - DOME) / DOME_RADIUS, 0.0, np.pi / 2.0)
    return np.minimum(level, DOME) + DOME_RADIUS * np.sin(over)


def half_width(level: FloatArray) -> FloatArray:
    """Return half the head's width (...), mm, at a level."""
    return _profile(level)[0]


def smooth_head(phi: FloatArray, level: FloatArray) -> FloatArray:
    """Return the places (..., 3), mm, of the head without a face: superellipses one above the other.

    x = w sin phi; in front z = z_a + (front - z_a) cos^p phi, behind z_a - (z_a - back) |cos phi|.
    """
    width, front, back, point = _profile(level)
    cosine = np.cos(phi)
    before = AXIS_Z + (front - AXIS_Z) * np.maximum(cosine, 0.0) ** point
    behind = AXIS_Z + (AXIS_Z - back) * np.minimum(cosine, 0.0)
    z = np.where(cosine > 0.0, before, behind)
    return np.stack(np.broadcast_arrays(width * np.sin(phi), height(level), z), axis=-1)


def angle_of(x: FloatArray, level: FloatArray) -> FloatArray:
    """Return the angle phi, rad, of a place in front with this x, mm."""
    angle: FloatArray = np.arcsin(np.clip(x / half_width(level), -1.0, 1.0))
    return angle


def _profile(level: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    from scipy.interpolate import PchipInterpolator

    below = PchipInterpolator(_PROFILE[:, 0], _PROFILE[:, 1:])(np.clip(level, BOTTOM, DOME))
    over = np.cos(np.clip((level - DOME) / DOME_RADIUS, 0.0, np.pi / 2.0))
    width, front, back, point = np.moveaxis(below, -1, 0)
    return width * over, AXIS_Z + (front - AXIS_Z) * over, AXIS_Z + (back - AXIS_Z) * over, point
