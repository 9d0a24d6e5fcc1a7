"""How much a part of a surface is like a hand at the end of an arm."""

from __future__ import annotations

import numpy as np

from posetrack_cli.hand.config import DetectionSettings
from posetrack_cli.hand.segmentation.region import Exit, Region

_FINGER_MM, _OF_DISC = 36.0, 0.8
"""What is narrower than two fingers side by side, where it leads out of a hand's reach, is no arm, unless it
is about as wide as the disc: a thin arm goes on as wide as it is, a finger is narrower than its palm."""
_AREAS_MM2 = (800.0, 2500.0, 42000.0, 65000.0)
"""Of a hand with the part of its arm within reach: as small and as large as can be, usual in between."""
_NO_ARM, _MORE_ARMS, _LONG_FINGER = 0.75, 0.2, 0.9
"""Factors for a hand alone, for each further arm, for each finger that reaches too far."""
_OF_WIDEST, _NARROW = (0.1, 0.6), 0.2
"""A palm is the widest part of its surroundings: less than so much of the widest counts little."""
_BEHIND = (0.3, 0.8)
"""Shares of the rim behind something nearer: so much is usual, so much no hand."""
_LARGER_FIRST = 0.1


def arm_exit(region: Region) -> Exit | None:
    """Where the arm leads out of a region: the widest way, if it is no finger; None without one."""
    return max(_arms(region), key=lambda way: way.width_mm, default=None)


def likeness(region: Region, settings: DetectionSettings) -> float:
    """0 to 1, the product of what speaks for a hand: disc, area, one arm, and nothing before it.

    Nothing as wide as a body leads out of a hand's reach; the end of a finger is not the widest part of its
    surroundings; what is seen between things nearer is background.
    """
    low, high = settings.palm_radius_mm
    disc = _plateau(region.radius_mm, 0.8 * low, 1.3 * low, 0.8 * high, 1.1 * high)
    widest = float(np.interp(region.radius_mm / region.widest_mm, _OF_WIDEST, [_NARROW, 1.0]))
    area = _plateau(region.area_mm2, *_AREAS_MM2)
    before = float(np.interp(region.behind, _BEHIND, [1.0, 0.0]))
    larger = 1.0 - _LARGER_FIRST * (1.0 - min(1.0, region.radius_mm / high))
    return disc * widest * area * before * larger * _of_exits(region, settings)


def _of_exits(region: Region, settings: DetectionSettings) -> float:
    arms = [way.width_mm for way in _arms(region)]
    fingers = _LONG_FINGER ** (len(region.exits) - len(arms))
    if not arms:
        return fingers * _NO_ARM
    too_wide = float(np.interp(max(arms), [settings.arm_mm, 1.5 * settings.arm_mm], [1.0, 0.0]))
    return fingers * too_wide * _MORE_ARMS ** (len(arms) - 1)


def _arms(region: Region) -> list[Exit]:
    narrowest = min(_FINGER_MM, _OF_DISC * 2.0 * region.radius_mm)
    return [way for way in region.exits if way.width_mm >= narrowest]


def _plateau(value: float, low: float, first: float, last: float, high: float) -> float:
    """1 from ``first`` to ``last``, falling linearly to 0 at ``low`` and ``high``."""
    return float(np.interp(value, [low, first, last, high], [0.0, 1.0, 1.0, 0.0]))
