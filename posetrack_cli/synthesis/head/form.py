"""The form of an average head of our own making, its face and eyelids, in coordinates that every head shares.

A place on it is an angle phi about the vertical axis (0 in front, positive to the subject's left) and a
level, which is the height y up to the forehead and goes on along the skull to its top. What is painted or
moved is said in the average head's own x and y, as seen from in front.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.head.face.points import MEAN_SHAPE

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

INNER, OUTER = MEAN_SHAPE[2, :2], MEAN_SHAPE[3, :2]
"""Corners of the left eye."""
LENGTH = float(np.linalg.norm(OUTER - INNER))

# forward displacement, mm; x (both sides), y of its middle; spreads across and up and down, mm
_BUMPS = (
    (-6.5, 30.0, 6.0, 13.0, 9.0),  # eye sockets
    (-3.5, 15.0, 3.0, 4.5, 8.0),  # beside the nose's root
    (4.0, 31.0, -0.5, 9.5, 6.0),  # eyeballs
    (3.5, 26.0, 24.0, 17.0, 6.0),  # brow ridges
    (5.5, 45.0, -26.0, 15.0, 13.0),  # cheekbones
    (-3.0, 46.0, -62.0, 13.0, 16.0),  # hollow of the cheeks
    (3.0, 33.0, -58.0, 7.0, 10.0),  # beside the folds from nose to mouth
    (-2.0, 27.5, -56.0, 3.5, 9.0),  # those folds
    (-3.0, 0.0, -86.0, 13.0, 5.0),  # under the lower lip
    (4.0, 0.0, -104.0, 13.0, 9.0),  # chin
    (-2.5, 56.0, 22.0, 9.0, 16.0),  # temples
)
_NOSE_Y = np.array([14.0, 8.0, 2.0, -8.0, -20.0, -31.0, -37.0, -41.0, -44.5, -48.0, -52.0])
_NOSE_MM = np.array([0.0, 1.0, 3.5, 9.0, 16.0, 23.0, 25.0, 22.5, 15.0, 5.5, 0.0])
_NOSE_WIDTH = np.array([5.5, 5.5, 5.5, 6.0, 6.8, 8.0, 8.8, 9.2, 9.0, 8.5, 8.5])
_WINGS = (9.0, 12.0, -41.0, 4.6, 4.6)


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


def along_and_above(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where places lie on their side's eye: s, 0 at the inner corner, 1 at the outer, and mm above.

    Args:
        x, y: (...) mm; the right eye is the left one's mirror image.
    """
    axis = (OUTER - INNER) / LENGTH
    dx, dy = np.abs(x) - INNER[0], y - INNER[1]
    return (dx * axis[0] + dy * axis[1]) / LENGTH, dy * axis[0] - dx * axis[1]


class LidPlaces(NamedTuple):
    """Where places lie at an eye, and the lids there.

    Attributes:
        s: (...) 0 at the inner corner, 1 at the outer.
        above: (...) mm above the line between the corners.
        top, bottom: (...) edges of the upper and the lower lid, likewise.
    """

    s: FloatArray
    above: FloatArray
    top: FloatArray
    bottom: FloatArray


def upper_edge(s: FloatArray, most: float) -> FloatArray:
    """Return the upper lid's height (...), mm above the line between the corners; 0 beyond them."""
    inside = np.clip(s, 0.0, 1.0)
    edge: FloatArray = most * (4.0 * inside * (1.0 - inside)) ** 0.75 * (1.06 - 0.12 * inside)
    return edge


def lower_edge(s: FloatArray, most: float) -> FloatArray:
    """Return the lower lid's height (...), mm, negative."""
    inside = np.clip(s, 0.0, 1.0)
    edge: FloatArray = -most * (4.0 * inside * (1.0 - inside)) ** 0.85 * (0.92 + 0.16 * inside)
    return edge


@dataclass(frozen=True)
class Relief:
    """How a face differs from the average one where no feature point says so; 1 is the average.

    Attributes:
        nose: factor on how far the nose stands out.
        nose_width: factor on the nose's width.
        lips: factor on the lips' fullness.
        bones: factor on cheeks, brow ridges and chin.
    """

    nose: float = 1.0
    nose_width: float = 1.0
    lips: float = 1.0
    bones: float = 1.0


def forward(x: FloatArray, y: FloatArray, relief: Relief) -> FloatArray:
    """Return how far (...) the skin stands out, mm along z, at places of the average head."""
    total = sum((_pair(x, y, bump) for bump in _BUMPS), start=np.zeros(np.shape(x))) * relief.bones
    return total + relief.nose * _nose(x / relief.nose_width, y) + relief.lips * _lips(x, y)


def _pair(x: FloatArray, y: FloatArray, bump: tuple[float, ...]) -> FloatArray:
    size, middle, up, across, down = bump
    vertical = np.exp(-0.5 * ((y - up) / down) ** 2)
    sides = np.exp(-0.5 * ((np.abs(x) - middle) / across) ** 2)
    both: FloatArray = size * vertical * sides
    return both


def _nose(x: FloatArray, y: FloatArray) -> FloatArray:
    from scipy.interpolate import PchipInterpolator

    where = np.clip(y, _NOSE_Y[-1], _NOSE_Y[0])
    ridge = PchipInterpolator(_NOSE_Y[::-1], _NOSE_MM[::-1])(where)
    width = np.interp(where, _NOSE_Y[::-1], _NOSE_WIDTH[::-1])
    across = np.exp(-0.5 * np.abs(x / width) ** 2.4)
    nose: FloatArray = ridge * across + _pair(x, y, _WINGS)
    return nose


def _lips(x: FloatArray, y: FloatArray) -> FloatArray:
    """Two rolls that meet in a crease; the upper one has a hollow in its middle."""
    along = np.sqrt(np.clip(1.0 - (x / 27.0) ** 2, 0.0, None))
    up = y - MOUTH_Y
    upper = 7.0 * np.exp(-0.5 * ((up - 3.6) / 3.6) ** 2)
    lower = 8.0 * np.exp(-0.5 * ((up + 4.6) / 4.2) ** 2)
    crease = -4.5 * np.exp(-0.5 * (up / 1.3) ** 2)
    hollow = -1.2 * np.exp(-0.5 * (x / 2.6) ** 2 - 0.5 * ((up - 11.0) / 6.0) ** 2)
    lips: FloatArray = along * (upper + lower + crease) + hollow
    return lips
