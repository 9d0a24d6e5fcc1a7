"""Whether images belong to other cameras than they are said to, told from faces found in each **[ours]**.

The epipolar error tells where the cameras' heights or directions differ. Cameras that converge on the face
from the sides see it on the same lines either way; but exchanged, they see it hollow.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.epipolar import better_order
from posetrack_cli.geometry.triangulation import triangulate
from posetrack_cli.head.start.completion import deviations

# Another order must be so many times more like a face, and as like one as this, to be believed.
CLEARLY_BETTER = 1.6
LIKE_A_FACE = 2.0
# So many points must be in front of the cameras for a shape to be looked at.
LEAST_POINTS = 8


def exchanged_order(cameras: Sequence[Camera], faces: FloatArray) -> tuple[int, ...]:
    """Return which image each camera should get, if that fits clearly better than as recorded; else nothing.

    Args:
        cameras: C of them.
        faces: (C, K, 2) pixels of a face's points, found in each image by itself; NaN where there is none.
    """
    if np.isnan(faces).any():
        return ()
    by_lines = better_order(cameras, faces)
    if by_lines is not None:
        return by_lines.order
    as_recorded, *others = permutations(range(len(cameras)))
    best = min(others, key=lambda order: face_deviation(cameras, faces[list(order)]))
    deviation = face_deviation(cameras, faces[list(best)])
    limit = min(LIKE_A_FACE, face_deviation(cameras, faces[list(as_recorded)]) / CLEARLY_BETTER)
    return best if deviation < limit else ()


def face_deviation(cameras: Sequence[Camera], pixels: FloatArray) -> float:
    """Return how unlike an average face the points with pixels (C, K, 2) are, root mean square deviations.

    Infinite if too few of them lie in front of the cameras.
    """
    points, known = triangulate(cameras, pixels)
    if known.sum() < LEAST_POINTS:
        return np.inf
    return float(np.sqrt(np.mean(deviations(points, known)[known] ** 2)))
