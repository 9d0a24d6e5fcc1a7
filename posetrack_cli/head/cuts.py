"""Cuts: a video goes on with another scene, perhaps another person, from one frame to the next **[ours]**.

The feature points cannot tell: ten small patches find something like themselves in any face. But the whole
image changes in a cut, as it never does within a thirtieth of a second of one scene.
"""

from __future__ import annotations

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray

WIDTH, HEIGHT = 32, 24
SAME_SCENE = 0.9
"""Correlation of two thumbnails. Heads that move fast before a camera leave it above .95; cuts came to .55,
and to .83 where only the face changed."""


def thumbnail(image: ImageArray) -> FloatArray:
    """Return a small version (HEIGHT * WIDTH,) of an image, zero mean and unit norm; zeros of an even one."""
    small = cv2.resize(image, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
    small -= small.mean()
    norm = float(np.linalg.norm(small))
    scaled: FloatArray = small / norm if norm > 0.0 else small
    return scaled


def is_cut(before: FloatArray, after: FloatArray) -> bool:
    """Whether two thumbnails are of different scenes."""
    return float(before @ after) < SAME_SCENE
