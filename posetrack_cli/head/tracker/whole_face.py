"""Where a face went from one frame to the next as a whole, when its points were lost **[ours]**.

Ten small patches follow a head that moves as was expected. Where it moves by more than they reach, the
surroundings of all of them together, which are nearly all of a face, still say how far: of all shifts the one
is taken under which the windows about the points in the frame before correlate best with the image, on
average. Turns and changes of size are left to the fit that begins there.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.head.face.templates import WINDOW, TemplateSet

REDUCED = 2
"""Images and windows are looked at at half their size: a pixel more or less is no matter for a start."""
SLACK = 4
"""Reduced pixels by which each point may have moved otherwise than the whole."""
REACH_PX = 96
"""The longest shift along an axis: three quarters of the eyes' distance in images as they are reduced."""


class Shift(NamedTuple):
    """How a face moved in an image.

    Attributes:
        pixels: (2,) x and y.
        likeness: mean correlation there, -1 to 1.
        places: (K, 2) where each point then looks most like itself, pixels; NaN where it was not seen before.
        weights: (K,) its correlation there, 0 where it is below 0 or the point was not seen.
    """

    pixels: FloatArray
    likeness: float
    places: FloatArray
    weights: FloatArray


def shift_of(image: ImageArray, templates: TemplateSet, pixels: FloatArray) -> Shift | None:
    """Return where a face went, None where no point of it was seen before.

    Args:
        image: (height, width) grey, of the one camera.
        templates: of the frame before.
        pixels: (K, 2) where its points were then.
    """
    seen = np.flatnonzero(templates.seen[0])
    if not len(seen):
        return None
    margin = (REACH_PX + WINDOW) // REDUCED
    small = cv2.resize(image, None, fx=1.0 / REDUCED, fy=1.0 / REDUCED, interpolation=cv2.INTER_AREA)
    wide = cv2.copyMakeBorder(small, margin, margin, margin, margin, cv2.BORDER_REPLICATE)
    corners = np.rint((pixels - templates.centres[0]) / REDUCED).astype(int)
    corners = np.clip(corners, 0, np.array(small.shape[::-1]) - WINDOW // REDUCED)
    each = [_likeness(wide, templates.windows[0, k], corners[k] + margin) for k in seen]
    near = np.ones((2 * SLACK + 1, 2 * SLACK + 1), np.uint8)
    mean = np.mean([cv2.dilate(one, near) for one in each], axis=0)
    row, column = np.unravel_index(int(np.argmax(mean)), mean.shape)
    moved = REDUCED * np.array([column, row], dtype=np.float64) - REACH_PX
    places, weights = np.full(pixels.shape, np.nan), np.zeros(len(pixels))
    for k, one in zip(seen, each, strict=True):
        top, left = max(row - SLACK, 0), max(column - SLACK, 0)
        part = one[top : row + SLACK + 1, left : column + SLACK + 1]
        y, x = np.unravel_index(int(np.argmax(part)), part.shape)
        places[k] = pixels[k] + REDUCED * np.array([left + x, top + y], dtype=np.float64) - REACH_PX
        weights[k] = max(float(part[y, x]), 0.0)
    return Shift(moved, float(mean[row, column]), places, weights)


def _likeness(wide: ImageArray, window: ImageArray, corner: IntArray) -> Float32Array:
    """Return the correlations of a window with an image under all shifts from its corner."""
    side, reach = WINDOW // REDUCED, REACH_PX // REDUCED
    template = cv2.resize(window, (side, side), interpolation=cv2.INTER_AREA)
    left, top = int(corner[0]) - reach, int(corner[1]) - reach
    around = wide[top : top + side + 2 * reach, left : left + side + 2 * reach]
    return np.asarray(cv2.matchTemplate(around, template, cv2.TM_CCOEFF_NORMED), dtype=np.float32)
