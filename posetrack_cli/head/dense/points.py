"""Dense points of a face: jaw, nose base, lips, lids with corners, brows and irises.

Points are numbered as in the usual scheme of 68, without the upper jaw line and the bridge of the nose, which
an image shows only as contour or shading; irises follow. Right is the subject's right.
"""

from __future__ import annotations

import itertools

JAW = tuple(range(4, 13))
NOSE_BASE = tuple(range(31, 36))
OUTER_LIPS = tuple(range(48, 60))
INNER_LIPS = tuple(range(60, 68))
RIGHT_BROW, LEFT_BROW = tuple(range(17, 22)), tuple(range(26, 21, -1))
"""From the outer end to the inner one."""
RIGHT_LIDS, LEFT_LIDS = (36, 37, 38, 39, 40, 41), (45, 44, 43, 42, 47, 46)
"""Outer corner, upper lid, inner corner, lower lid."""
RIGHT_IRIS, LEFT_IRIS = 68, 69

MOUTH_POINTS = (*JAW, *NOSE_BASE, *OUTER_LIPS, *INNER_LIPS)
EYE_POINTS = ((*RIGHT_BROW, *RIGHT_LIDS, RIGHT_IRIS), (*LEFT_BROW, *LEFT_LIDS, LEFT_IRIS))
"""Of the right and of the left eye; corresponding points have the same index."""
NUMBERS = (*MOUTH_POINTS, *EYE_POINTS[0], *EYE_POINTS[1])
"""Numbers of all D points, in the order of arrays."""
DENSE_COUNT = len(NUMBERS)
_KINDS = {
    "jaw": JAW,
    "nose": NOSE_BASE,
    "outer_lip": OUTER_LIPS,
    "inner_lip": INNER_LIPS,
    "right_brow": RIGHT_BROW,
    "left_brow": LEFT_BROW,
    "right_lid": RIGHT_LIDS,
    "left_lid": LEFT_LIDS,
}
_NAMES = {number: f"{kind}_{number}" for kind, numbers in _KINDS.items() for number in numbers} | {
    RIGHT_IRIS: "right_iris",
    LEFT_IRIS: "left_iris",
}
DENSE_NAMES = tuple(_NAMES[number] for number in NUMBERS)
"""D names, such as ``inner_lip_62``."""


def rows(*numbers: int) -> list[int]:
    """Return the rows of points, given their numbers."""
    return [NUMBERS.index(number) for number in numbers]


def _line(*numbers: int) -> list[tuple[int, int]]:
    at = rows(*numbers)
    return list(itertools.pairwise(at))


DENSE_LINES = (
    *_line(*JAW),
    *_line(*NOSE_BASE),
    *_line(*OUTER_LIPS, OUTER_LIPS[0]),
    *_line(*INNER_LIPS, INNER_LIPS[0]),
    *_line(*RIGHT_BROW),
    *_line(*LEFT_BROW),
    *_line(*RIGHT_LIDS, RIGHT_LIDS[0]),
    *_line(*LEFT_LIDS, LEFT_LIDS[0]),
)
"""Pairs of rows that are drawn as lines."""
