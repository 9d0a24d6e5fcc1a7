"""What is estimated of a frame inside, beside a hand's 22 numbers **[ours]**.

Six inner numbers, integrated out of what a frame tells of a pose, and then the same for all its particles:

    0:3    forearm: unit direction from wrist to elbow, camera axes; 0 where none is explained
    3      forearm: logarithm of its girth's factor
    4      thumb: flexion of its last joint (IP) beyond the half of the MCP's that the pose gives it, rad
    5      thumb: abduction of its MCP, rad, with the sign of the CMC's
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray

INNER_SIZE = 6
FOREARM, THUMB = slice(0, 4), slice(4, INNER_SIZE)
LOG_GIRTH, IP_OFFSET, MCP_ABDUCTION = 3, 4, 5
NO_INNER: FloatArray = np.zeros(INNER_SIZE)
NO_THUMB: FloatArray = np.zeros(2)
RELAXED_INNER: FloatArray = np.array([0.0, 0.0, 0.0, 0.0, np.deg2rad(14.0), 0.0])
"""(6,) what is expected before any frame told: the last joint of a thumb that rests bends farther than by
half of what its MCP does. Our hands, laid on the joints of people 640 to 753, have 17 degrees, sd 13."""

FOREARM_NUMBERS = ("forearm_x", "forearm_y", "forearm_z", "forearm_girth")
"""What estimates say of it: the unit direction from wrist to elbow, camera axes, and the girth as a
factor on that which the hand's wrist lets expect; not known where none is explained."""
THUMB_NUMBERS = ("thumb_ip_offset", "thumb_mcp_abduction")
"""The thumb's two inner angles, rad."""
INNER_NUMBERS = (*FOREARM_NUMBERS, *THUMB_NUMBERS)


def inner_numbers(inner: FloatArray) -> FloatArray:
    """What ``INNER_NUMBERS`` name (6,) of inner numbers (6,); NaN for a forearm that there is not."""
    arm = np.append(inner[:3], np.exp(inner[LOG_GIRTH])) if inner[:3].any() else np.full(4, np.nan)
    return np.concatenate([arm, inner[THUMB]])


def inner_of(numbers: FloatArray | None) -> FloatArray:
    """The inner numbers (6,) that numbers of ``inner_numbers`` tell; 0 for those that a result has not got.

    Args:
        numbers: (6,) and what comes after them, (4,) of a result that has a forearm's alone, or anything
            shorter of one with neither.
    """
    inner = NO_INNER.copy()
    if numbers is None or len(numbers) < len(FOREARM_NUMBERS):
        return inner
    arm = numbers[FOREARM]
    if np.isfinite(arm).all() and arm[3] > 0.0:
        inner[FOREARM] = np.append(arm[:3], np.log(arm[3]))
    inner[THUMB] = thumbs_of(numbers[None], 1)[0]
    return inner


def thumbs_of(numbers: FloatArray | None, count: int) -> FloatArray:
    """The thumbs' inner angles (count, 2), rad, of numbers (count, M) as in ``inner_of``."""
    if numbers is None or numbers.shape[1] < INNER_SIZE:
        return np.zeros((count, len(NO_THUMB)))
    thumbs = numbers[:, THUMB]
    return np.where(np.isfinite(thumbs), thumbs, 0.0)
