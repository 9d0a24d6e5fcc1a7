"""The faces that landmarks tell of a frame, in the images that a tracker looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.detection.points import EYE_DISTANCE_MM, FacePoints
from posetrack_cli.head.face.points import FEATURE_SD, FEATURES
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.face.scaling import WHOLE, scaled_pixels
from posetrack_cli.head.initialisation.single_view import pose_of
from posetrack_cli.head.landmarks.file import LandmarkFile
from posetrack_cli.recording.base import Frame

SLID_NOISE, SLID_EYES = 4.0, 0.08
"""A tracked point has slid if it is so many standard deviations and eye distances from its landmark."""
BESIDE_EYES = 0.16
"""A feature lies no farther beside its landmark: programs do not agree where a brow ends."""
LEAST_RESPONSE = 0.5
"""From so much on a place looks like its point."""
SLID_POINTS = 3
"""So many points that have slid make a track doubtful."""


@dataclass(frozen=True, eq=False)
class ToldFace:
    """A face that landmarks tell.

    Attributes:
        stamp_ns: of its frame where it is known, else 0.
        pixels: (K, 2); a point that was not told is where an average face has it.
        responses: (K,) scores, 0 to 1; 0 of a point that was not told.
        pixels_per_mm: scale of the face in the image.
    """

    stamp_ns: int
    pixels: FloatArray
    responses: FloatArray
    pixels_per_mm: float


class Landmarks:
    """Landmarks for a tracker that looks at images of one camera.

    Args:
        file: as it was read.
        camera: of the images that are looked at.
        scale: of them beside the recorded ones.
    """

    def __init__(self, file: LandmarkFile, camera: Camera, scale: float = WHOLE) -> None:
        self._file, self._camera, self._scale = file, camera, scale
        self.noise_px: FloatArray = scale * file.noise_px

    def faces(self, frame: Frame) -> tuple[ToldFace, ...]:
        """Return the faces of a frame, the largest first."""
        rows = self._file.sets.of(frame.index, frame.stamp_ns)
        found = (self._face(row, frame.stamp_ns) for row in range(rows.start, rows.stop))
        faces = [face for face in found if face is not None]
        return tuple(sorted(faces, key=lambda face: -face.pixels_per_mm))

    def has_slid(self, pixels: FloatArray, face: ToldFace) -> bool:
        """Whether tracked points (K, 2) are elsewhere than a face's."""
        return int(np.sum(self._is_off(pixels, face) & (face.responses > 0.0))) >= SLID_POINTS

    def placed(self, seen: FacePoints, face: ToldFace) -> FloatArray:
        """Return where a track begins, (K, 2): at the features that are seen near a face's landmarks.

        What is followed is what a point looks like; a landmark lies a few pixels beside that, by another
        program's convention and by its noise. It stands where nothing near it looks like the point.
        """
        looks_like = (seen.responses > LEAST_RESPONSE) & ~self._is_off(seen.pixels, face, BESIDE_EYES)
        return np.where((looks_like | (face.responses <= 0.0))[:, None], seen.pixels, face.pixels)

    def _is_off(self, pixels: FloatArray, face: ToldFace, least_eyes: float = SLID_EYES) -> BoolArray:
        off = np.linalg.norm(pixels - face.pixels, axis=1)
        most = np.maximum(SLID_NOISE * self.noise_px, least_eyes * EYE_DISTANCE_MM * face.pixels_per_mm)
        far: BoolArray = off > most
        return far

    def _face(self, row: int, stamp_ns: int) -> ToldFace | None:
        """The face of a row of the file; None where its points are no face's before this camera."""
        sets = self._file.sets
        known = np.isfinite(sets.points[row, :, 0]) & (sets.scores[row] > 0.0)
        scores = np.where(known, sets.scores[row], 0.0)
        pixels = scaled_pixels(sets.points[row, :, :2], self._scale)
        try:
            pose, _ = pose_of(pixels, scores * FEATURE_SD.min() / FEATURE_SD, self._camera, FEATURES)
        except ValueError:
            return None
        expected = project((self._camera,), pose.points(FEATURES)).pixels[0]
        filled = np.where(known[:, None], pixels, expected)
        if not np.isfinite(filled).all() or pose.position[2] <= 0.0:
            return None
        return ToldFace(stamp_ns, filled, scores, float(self._camera.fx / pose.position[2]))
