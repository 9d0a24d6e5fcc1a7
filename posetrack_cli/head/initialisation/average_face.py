"""An average face fitted to measured points, to detect outliers and fill in missing points.

It also detects images assigned to the wrong cameras **[ours]**. Epipolar errors show it if the cameras differ
in height or direction. Cameras that converge symmetrically on the face have the same epipolar lines either
way, but with swapped images the face becomes hollow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera, in_camera_axes
from posetrack_cli.geometry.rigid import better_order, rigid_alignment, triangulate
from posetrack_cli.head.face.points import FEATURE_SD, FEATURES
from posetrack_cli.head.face.rig_images import CameraImage

# A point this many standard deviations from the average face's was matched wrongly.
OUTLIER_SD = 2.0
# Removing more points would make anything a face.
MOST_OUTLIERS = 2


@dataclass(frozen=True, eq=False)
class MeasuredFace:
    """Measured points of a face, possibly incomplete.

    Attributes:
        points: (K, 3) mm, in the reference camera's axes; arbitrary where not known.
        known: (K,) which points are measured, at least three.
    """

    points: FloatArray
    known: BoolArray

    @property
    def size(self) -> float:
        """Size of the face relative to the average, from the weighted spread of the known points."""
        return float(np.sqrt(_spread(self.points, self._weights) / _spread(FEATURES, self._weights)))

    @property
    def average(self) -> FloatArray:
        """The average face (K, 3), scaled and aligned to the known points."""
        size = self.size
        rotation, shift = rigid_alignment(size * FEATURES, self.points, self._weights)
        average: FloatArray = size * FEATURES @ rotation.T + shift
        return average

    @property
    def deviations(self) -> FloatArray:
        """(K,) RMS distance of each coordinate from the aligned average face, in standard deviations."""
        distances: FloatArray = np.sqrt(np.mean((self.points - self.average) ** 2, axis=1)) / FEATURE_SD
        return distances

    @property
    def deviation(self) -> float:
        """Root mean square of the known points' deviations."""
        return float(np.sqrt(np.mean(self.deviations[self.known] ** 2)))

    def without_outliers(self) -> MeasuredFace:
        """Return the face without up to two points that deviate from the face of the others.

        More than five points must be known.
        """
        face = self
        for _ in range(MOST_OUTLIERS):
            distances = np.array(
                [face._from_others(k) if known else 0.0 for k, known in enumerate(face.known)]
            )
            worst = int(np.argmax(distances))
            if distances[worst] <= OUTLIER_SD:
                break
            face = face._without(worst)
        return face

    def completed(self, view: CameraImage, pixels: FloatArray) -> FloatArray:
        """Return the points (K, 3), mm, with missing ones filled in.

        Args:
            view: a camera that sees all points.
            pixels: (K, 2) in its image; a missing point lies on the ray of its pixel at the average face's
                depth.
        """
        depths = in_camera_axes(view.camera, self.average)[:, 2]
        return np.where(self.known[:, None], self.points, view.points_at(pixels, depths))

    @property
    def _weights(self) -> FloatArray:
        return np.where(self.known, FEATURE_SD**-2, 0.0)

    def _without(self, point: int) -> MeasuredFace:
        return MeasuredFace(self.points, self.known & (np.arange(len(self.known)) != point))

    def _from_others(self, point: int) -> float:
        """Return the deviation of one point from the face fitted to the others."""
        return float(self._without(point).deviations[point])


def _spread(points: FloatArray, weights: FloatArray) -> float:
    share = weights / weights.sum()
    return float(share @ np.sum((points - share @ points) ** 2, axis=1))


# Another order is accepted if its face deviates less by this factor, and by at most MOST_DEVIATION.
BETTER_FACTOR = 1.6
MOST_DEVIATION = 2.0
# Minimum number of points in front of the cameras.
LEAST_POINTS = 8


def swapped_order(cameras: Sequence[Camera], faces: FloatArray) -> tuple[int, ...]:
    """Return the image order that fits clearly better than the recorded one; empty if there is none.

    Args:
        cameras: C of them.
        faces: (C, K, 2) pixels of a face's points, detected in each image separately; NaN without a face.
    """
    if np.isnan(faces).any():
        return ()
    by_lines = better_order(cameras, faces)  # epipolar errors first: they need no model of a face
    if by_lines is not None:
        return by_lines.order
    as_recorded, *others = permutations(range(len(cameras)))
    best = min(others, key=lambda order: face_deviation(cameras, faces[list(order)]))
    deviation = face_deviation(cameras, faces[list(best)])
    limit = min(MOST_DEVIATION, face_deviation(cameras, faces[list(as_recorded)]) / BETTER_FACTOR)
    return best if deviation < limit else ()


def face_deviation(cameras: Sequence[Camera], pixels: FloatArray) -> float:
    """Return the RMS deviation from an average face of points at pixels (C, K, 2).

    Infinite if too few of them lie in front of the cameras.
    """
    face = MeasuredFace(*triangulate(cameras, pixels))
    return face.deviation if face.known.sum() >= LEAST_POINTS else np.inf
