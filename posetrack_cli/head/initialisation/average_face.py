"""An average face laid on measured points: which of them are wrong, and where the others must be.

It also tells whether images belong to other cameras than they are said to **[ours]**. The epipolar error
tells where the cameras' heights or directions differ. Cameras that converge on the face from the sides see it
on the same lines either way; but exchanged, they see it hollow.
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

# A point so many standard deviations from an average face's was matched with something else.
OUTLYING = 2.0
# With more of them taken away anything can be made a face.
MOST_OUTLIERS = 2


@dataclass(frozen=True, eq=False)
class MeasuredFace:
    """The points of a face of which some were measured.

    Attributes:
        points: (K, 3) mm, in the reference camera's axes; anything where not known.
        known: (K,) which of them are measured, at least three.
    """

    points: FloatArray
    known: BoolArray

    @property
    def size(self) -> float:
        """How large the face is, 1 for an average one: the ratio of the known points' weighted spreads."""
        return float(np.sqrt(_spread(self.points, self._weights) / _spread(FEATURES, self._weights)))

    @property
    def average(self) -> FloatArray:
        """The points (K, 3) of an average face, scaled, turned and moved onto the known ones."""
        size = self.size
        rotation, shift = rigid_alignment(size * FEATURES, self.points, self._weights)
        average: FloatArray = size * FEATURES @ rotation.T + shift
        return average

    @property
    def deviations(self) -> FloatArray:
        """How far all points lie from an average face on the known ones, in standard deviations.

        The face is as large as the known points; each distance (K,) is a root mean square over coordinates.
        """
        distances: FloatArray = np.sqrt(np.mean((self.points - self.average) ** 2, axis=1)) / FEATURE_SD
        return distances

    @property
    def deviation(self) -> float:
        """Root mean square of the known points' deviations."""
        return float(np.sqrt(np.mean(self.deviations[self.known] ** 2)))

    def without_outliers(self) -> MeasuredFace:
        """Return the face without the worst points, two at most, that lie unlike a face's.

        More than five must be known.
        """
        face = self
        for _ in range(MOST_OUTLIERS):
            distances = np.array(
                [face._from_others(k) if known else 0.0 for k, known in enumerate(face.known)]
            )
            worst = int(np.argmax(distances))
            if distances[worst] <= OUTLYING:
                break
            face = face._without(worst)
        return face

    def completed(self, view: CameraImage, pixels: FloatArray) -> FloatArray:
        """Return the points (K, 3), mm, with those filled in that are not known.

        Args:
            view: the camera that saw all points.
            pixels: (K, 2) where it saw them; an unknown point lies on the ray of its pixel, as deep as an
                average face has it.
        """
        depths = in_camera_axes(view.camera, self.average)[:, 2]
        return np.where(self.known[:, None], self.points, view.points_at(pixels, depths))

    @property
    def _weights(self) -> FloatArray:
        return np.where(self.known, FEATURE_SD**-2, 0.0)

    def _without(self, point: int) -> MeasuredFace:
        return MeasuredFace(self.points, self.known & (np.arange(len(self.known)) != point))

    def _from_others(self, point: int) -> float:
        """Return the deviation of one point from the face that the other known ones make."""
        return float(self._without(point).deviations[point])


def _spread(points: FloatArray, weights: FloatArray) -> float:
    share = weights / weights.sum()
    return float(share @ np.sum((points - share @ points) ** 2, axis=1))


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
    face = MeasuredFace(*triangulate(cameras, pixels))
    return face.deviation if face.known.sum() >= LEAST_POINTS else np.inf
