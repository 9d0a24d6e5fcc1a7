"""Where a face went from one frame to the next as a whole, when its points were lost **[ours]**.

Ten small patches follow a head that moves as was expected. Where it moves by more than they reach, the
surroundings of all of them together, which are nearly all of a face, still say how far: of all shifts the one
is taken under which the windows about the points in the frame before correlate best with the image, on
average. Each may then be a little beside its place, as they are where a head turns, comes nearer or moves
its mouth; where each is best tells of the turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.head.face.templates import WINDOW, TemplateSet

REDUCED = 2
"""Images and windows are looked at at half their size: a pixel more or less is no matter for a start."""
REACH_PX = 96
"""The longest shift along an axis: a little more than the eyes' distance in images as they are reduced."""
SLACK = 5
"""Reduced pixels by which a point may go another way than the whole along an axis: an eighth of that
distance, as in a turn by some 20 degrees within a frame."""


class Shift(NamedTuple):
    """How a face moved in an image.

    Attributes:
        pixels: (2,) x and y.
        likeness: mean correlation there, -1 to 1, each window's the best within its slack.
        places: (K, 2) pixels of the points where these are; NaN of a point that was not seen before.
        likenesses: (K,) the correlations, 0 where they are below or the point was not seen before.
    """

    pixels: FloatArray
    likeness: float
    places: FloatArray
    likenesses: FloatArray


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
    roughly = np.array(np.unravel_index(int(np.argmax(mean)), mean.shape))
    middle = np.rint(np.median(_best_near(each, roughly), axis=0)).astype(int)
    places, likenesses = np.full(pixels.shape, np.nan), np.zeros(len(pixels))
    best = _best_near(each, middle)
    places[seen] = pixels[seen] + _moved(best)
    likenesses[seen] = [
        max(float(one[row, column]), 0.0) for one, (row, column) in zip(each, best, strict=True)
    ]
    return Shift(_moved(middle), float(mean[tuple(roughly)]), places, likenesses)


def _best_near(each: Sequence[Float32Array], place: IntArray) -> IntArray:
    """Return the row and column (n, 2), within the slack of a place, where each of n maps is greatest."""
    first, found = np.maximum(place - SLACK, 0), []
    for one in each:
        part = one[first[0] : place[0] + SLACK + 1, first[1] : place[1] + SLACK + 1]
        found.append(first + np.unravel_index(int(np.argmax(part)), part.shape))
    return np.array(found)


def _moved(places: IntArray) -> FloatArray:
    """Return the shifts (..., 2), pixels along x and y, of rows and columns in a map of likenesses."""
    shifts: FloatArray = REDUCED * places[..., ::-1].astype(np.float64) - REACH_PX
    return shifts


def _likeness(wide: ImageArray, window: ImageArray, corner: IntArray) -> Float32Array:
    """Return the correlations of a window with an image under all shifts from its corner."""
    side, reach = WINDOW // REDUCED, REACH_PX // REDUCED
    template = cv2.resize(window, (side, side), interpolation=cv2.INTER_AREA)
    left, top = int(corner[0]) - reach, int(corner[1]) - reach
    around = wide[top : top + side + 2 * reach, left : left + side + 2 * reach]
    return np.asarray(cv2.matchTemplate(around, template, cv2.TM_CCOEFF_NORMED), dtype=np.float32)
