"""What makes a face of a smooth head: nose, eye sockets, cheeks, lips, chin, as displacements of the skin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.synthesis.head.form import MOUTH_Y

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
