"""Ten feature points of a face: their names, their order, and what faces have in common.

The head's frame: x to the subject's left, y up, z out of the face, mm; the origin is the mean of the four eye
corners of the neutral face. A shape is (K, 3), K = 10 rows in the order of ``POINT_NAMES``.

The figures are statistics of ten landmarks over 4000 samples of ICT-FaceKit's identity model (USC Institute
for Creative Technologies, MIT licence).
"""

from __future__ import annotations

import numpy as np

POINT_NAMES = (
    "right_eye_outer",
    "right_eye_inner",
    "left_eye_inner",
    "left_eye_outer",
    "right_mouth_corner",
    "left_mouth_corner",
    "right_nostril",
    "left_nostril",
    "right_brow_inner",
    "left_brow_inner",
)
POINT_COUNT = len(POINT_NAMES)
EYES, MOUTH, NOSTRILS, BROWS = slice(0, 4), slice(4, 6), slice(6, 8), slice(8, 10)
MIRRORED = (3, 2, 1, 0, 5, 4, 7, 6, 9, 8)
"""Which point each becomes in a mirror."""
LINES = ((0, 1), (2, 3), (4, 5), (6, 7), (8, 9))
"""Pairs that are drawn as lines, each an eye, the mouth, the nose or the brows."""

MEAN_SHAPE = np.array(
    [
        [-44.6, 0.9, -3.0],
        [-18.4, -0.9, 3.0],
        [18.4, -0.9, 3.0],
        [44.6, 0.9, -3.0],
        [-25.4, -68.7, 12.9],
        [25.4, -68.7, 12.9],
        [-6.0, -44.8, 25.2],
        [6.0, -44.8, 25.2],
        [-11.7, 25.7, 18.4],
        [11.7, 25.7, 18.4],
    ]
)
"""(K, 3) mean over identities, neutral, mm."""

SHAPE_SD = np.array(
    [
        [2.6, 1.8, 1.9],
        [1.7, 1.5, 1.6],
        [1.7, 1.5, 1.6],
        [2.6, 1.8, 1.9],
        [2.0, 3.3, 1.4],
        [2.0, 3.3, 1.4],
        [0.7, 1.7, 2.0],
        [0.7, 1.7, 2.0],
        [0.8, 2.3, 2.0],
        [0.8, 2.3, 2.0],
    ]
)
"""(K, 3) standard deviations between identities, mm, after rigid alignment."""
_OUT = np.array(
    [
        [-0.8, 0.0, 1.0],
        [-0.1, 0.0, 1.0],
        [0.1, 0.0, 1.0],
        [0.8, 0.0, 1.0],
        [-0.54, 0.0, 1.0],
        [0.54, 0.0, 1.0],
        [-0.2, -0.5, 1.0],
        [0.2, -0.5, 1.0],
        [-0.1, 0.1, 1.0],
        [0.1, 0.1, 1.0],
    ]
)
POINT_NORMALS = _OUT / np.linalg.norm(_OUT, axis=1, keepdims=True)
"""(K, 3) unit vectors out of the skin about each point, roughly, **[ours]**: no statistics give them."""
for _figures in (MEAN_SHAPE, SHAPE_SD, POINT_NORMALS):
    _figures.setflags(write=False)
