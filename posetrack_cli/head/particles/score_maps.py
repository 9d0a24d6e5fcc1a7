"""How well each template fits around a place: one map for all particles **[ours]**.

The thesis correlates per particle and point (3.3.1). All particles see a point within a small box of the
image; there one cv2.matchTemplate gives every correlation at once, and particles look theirs up. The numbers
are the same, and the cost depends on the box, not on the number of particles.

A template has PATCH x PATCH pixels, at the offsets (column - 7.5, row - 7.5) from its point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, ImageArray
from posetrack_cli.head.face.patches import PATCH

HALF = 0.5 * (PATCH - 1)
LARGEST_BOX = 160
"""Pixels a side. It is cut about its middle beyond; particles outside score 0."""


class Box(NamedTuple):
    """Pixels of top left corners that a template is laid at: columns left..right, rows top..bottom."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def is_empty(self) -> bool:
        """Whether there is no place in the image for the template."""
        return self.right < self.left or self.bottom < self.top

    def holds(self, other: Box) -> bool:
        """Whether another box lies in this one."""
        return (
            self.left <= other.left
            and self.top <= other.top
            and self.right >= other.right
            and self.bottom >= other.bottom
        )

    def grown(self, margin: int, width: int, height: int) -> Box:
        """Return the box with a margin around it, within an image."""
        return Box(
            max(self.left - margin, 0),
            max(self.top - margin, 0),
            min(self.right + margin, width - PATCH),
            min(self.bottom + margin, height - PATCH),
        )


class ScoreMap(NamedTuple):
    """Normalised correlations, -1 to 1.

    Attributes:
        scores: (H, W).
        left, top: pixel of the point, not of the corner, for scores[0, 0].
    """

    scores: Float32Array
    left: float
    top: float


def boxes_around(
    u: Float32Array, v: Float32Array, width: int, height: int, largest: int = LARGEST_BOX
) -> list[Box]:
    """Return the places that the particles look at for each point, within the image.

    Args:
        u, v: (K, N) pixels of K points.
        width, height: of the image.
        largest: side; what is larger is cut about its middle.
    """
    columns = zip(u.min(axis=1).tolist(), u.max(axis=1).tolist(), strict=True)
    rows = zip(v.min(axis=1).tolist(), v.max(axis=1).tolist(), strict=True)
    boxes = []
    for (left, right), (top, bottom) in zip(columns, rows, strict=True):
        first, last = _span(left, right, width, largest), _span(top, bottom, height, largest)
        boxes.append(Box(first[0], last[0], first[1], last[1]))
    return boxes


def score_map(image: ImageArray, template: ImageArray, box: Box) -> ScoreMap:
    """Return the normalised correlations (TM_CCOEFF_NORMED) of a template at every place of a box.

    Args:
        image: (height, width), grey.
        template: (PATCH, PATCH) float32; mean and norm do not matter.
        box: not empty.
    """
    window = image[box.top : box.bottom + PATCH, box.left : box.right + PATCH].astype(np.float32)
    scores = cv2.matchTemplate(window, template, cv2.TM_CCOEFF_NORMED)
    return ScoreMap(np.asarray(scores, np.float32), box.left + HALF, box.top + HALF)


def _span(low: float, high: float, size: int, largest: int) -> tuple[int, int]:
    """Return the first and the last corner for points between low and high on an axis of `size` pixels."""
    last = size - PATCH
    first = math.floor(min(max(low - HALF, 0.0), last + 1.0))
    final = math.ceil(max(min(high - HALF, last), -1.0))
    excess = final - first + 1 - largest
    if excess > 0:
        first += excess // 2
        final = first + largest - 1
    return first, final
