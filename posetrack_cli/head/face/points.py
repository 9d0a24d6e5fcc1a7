"""Ten feature points of a face: their names, their order, and what faces have in common.

The head's frame: x to the subject's left, y up, z out of the face, mm; the origin is the mean of the four eye
corners of the neutral face. A shape is (K, 3), K = 10 rows in the order of ``POINT_NAMES``.

The figures are statistics of ten landmarks over 4000 samples of ICT-FaceKit's identity model (USC Institute
for Creative Technologies, MIT licence).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from posetrack_cli.arrays import FloatArray

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

FEATURES = MEAN_SHAPE.copy()
"""(K, 3) mm: where the image features of an average face lie in the head's frame.

They are ``MEAN_SHAPE`` but for two pairs: what a detector sees of a nostril is its opening, above the sill,
and of a brow its dark inner end, below the ridge that the statistics' landmark is on.
"""
FEATURES[NOSTRILS] = [[-8.5, -42.0, 26.0], [8.5, -42.0, 26.0]]
FEATURES[BROWS] = [[-15.5, 19.0, 19.0], [15.5, 19.0, 19.0]]

NOSE_BASE = np.array([0.0, -37.0, 26.0])
"""mm: middle of the arc that the nose's wings and base form. It guides the fit; no shape has it."""
FITTED = np.vstack([FEATURES, NOSE_BASE])
"""(K + 1, 3) mm: what a mean face is fitted by."""

FEATURE_SD = np.array([3.5, 3.0, 3.0, 3.5, 6.0, 6.0, 5.0, 5.0, 6.0, 6.0])
"""(K,) mm: identity, expression and the detector's error of one coordinate together **[ours]**."""


def of_kinds(*, eyes: ArrayLike, mouth: ArrayLike, nostrils: ArrayLike, brows: ArrayLike) -> FloatArray:
    """Return (K, ...) the value of each point's kind."""
    return np.array([eyes] * 4 + [mouth] * 2 + [nostrils] * 2 + [brows] * 2, dtype=np.float64)


for _figures in (MEAN_SHAPE, SHAPE_SD, POINT_NORMALS, FEATURES, FITTED, FEATURE_SD):
    _figures.setflags(write=False)
