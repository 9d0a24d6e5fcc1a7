"""An average face laid on measured points: which of them are wrong, and where the others must be."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.projection import in_camera_axes
from posetrack_cli.geometry.rigid_alignment import rigid_alignment
from posetrack_cli.head.detection.features import FEATURE_SD, FEATURES
from posetrack_cli.head.start.views import View

# A point so many standard deviations from an average face's was matched with something else.
OUTLYING = 2.0
# With more of them taken away anything can be made a face.
MOST_OUTLIERS = 2


def without_outliers(points: FloatArray, known: BoolArray) -> BoolArray:
    """Return which points remain when the worst ones, two at most, that lie unlike a face's are taken away.

    Args:
        points: (K, 3) mm.
        known: (K,) which of them are measured, more than five.
    """
    kept = known.copy()
    for _ in range(MOST_OUTLIERS):
        distances = np.array([_from_others(points, kept, k) if kept[k] else 0.0 for k in range(len(kept))])
        worst = int(np.argmax(distances))
        if distances[worst] <= OUTLYING:
            break
        kept[worst] = False
    return kept


def deviations(points: FloatArray, known: BoolArray) -> FloatArray:
    """Return how far points (K, 3) mm lie from an average face on the known ones, in standard deviations.

    The face is as large as the known points; each distance (K,) is a root mean square over coordinates.
    """
    average = average_face(points, known)
    distances: FloatArray = np.sqrt(np.mean((points - average) ** 2, axis=1)) / FEATURE_SD
    return distances


def _from_others(points: FloatArray, known: BoolArray, point: int) -> float:
    """Return the deviation of one point from the face that the other known ones make."""
    others = known & (np.arange(len(known)) != point)
    return float(deviations(points, others)[point])


def average_face(points: FloatArray, known: BoolArray) -> FloatArray:
    """Return the points (K, 3) of an average face, scaled, turned and moved onto the known ones."""
    weights = np.where(known, FEATURE_SD**-2, 0.0)
    size = relative_size(points, known)
    rotation, shift = rigid_alignment(size * FEATURES, points, weights)
    average: FloatArray = size * FEATURES @ rotation.T + shift
    return average


def relative_size(points: FloatArray, known: BoolArray) -> float:
    """Return how large a face is, 1 for an average one: the ratio of the known points' weighted spreads."""
    weights = np.where(known, FEATURE_SD**-2, 0.0)
    return float(np.sqrt(_spread(points, weights) / _spread(FEATURES, weights)))


def completed(points: FloatArray, known: BoolArray, view: View, pixels: FloatArray) -> FloatArray:
    """Return the points (K, 3), mm, with those filled in that are not known.

    Args:
        points: (K, 3) in the reference camera's axes; anything where not known.
        known: (K,) which points are measured, at least three.
        view: the camera that saw all points.
        pixels: (K, 2) where it saw them; an unknown point lies on the ray of its pixel, as deep as an average
            face has it.
    """
    depths = in_camera_axes(view.camera, average_face(points, known))[:, 2]
    return np.where(known[:, None], points, view.points_at(pixels, depths))


def _spread(points: FloatArray, weights: FloatArray) -> float:
    share = weights / weights.sum()
    return float(share @ np.sum((points - share @ points) ** 2, axis=1))
