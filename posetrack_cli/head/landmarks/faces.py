"""The faces that landmarks tell of a frame, in the images that a tracker looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.detection.points import EYE_DISTANCE_MM
from posetrack_cli.head.face.points import FEATURE_SD, FEATURES
from posetrack_cli.head.face.rig_images import project
from posetrack_cli.head.initialisation.single_view import pose_of
from posetrack_cli.head.landmarks.file import LandmarkFile
from posetrack_cli.head.tracker.reduction import WHOLE, reduced_pixels
from posetrack_cli.recording.base import Frame

IDENTITY_FRAMES = 15
"""Faces all over the file that tell who it is, beside those that a track begins with."""
SLID_NOISE, SLID_EYES = 4.0, 0.08
"""A tracked point has slid if it is so many standard deviations and eye distances from its landmark."""
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
        scale: that they are reduced by.
    """

    def __init__(self, file: LandmarkFile, camera: Camera, scale: float = WHOLE) -> None:
        self._file, self._camera, self._scale = file, camera, scale
        self.noise_px: FloatArray = scale * file.noise_px
        self._told = self._spread()

    def faces(self, frame: Frame) -> tuple[ToldFace, ...]:
        """Return the faces of a frame, the largest first."""
        rows = self._file.sets.of(frame.index, frame.stamp_ns)
        found = (self._face(row, frame.stamp_ns) for row in range(rows.start, rows.stop))
        faces = [face for face in found if face is not None]
        return tuple(sorted(faces, key=lambda face: -face.pixels_per_mm))

    @property
    def others(self) -> tuple[ToldFace, ...]:
        """Faces from all over the file; none where some frame has several, which may be several people's."""
        return self._told

    def has_slid(self, pixels: FloatArray, face: ToldFace) -> bool:
        """Whether tracked points (K, 2) are elsewhere than a face's."""
        off = np.linalg.norm(pixels - face.pixels, axis=1)
        most = np.maximum(SLID_NOISE * self.noise_px, SLID_EYES * EYE_DISTANCE_MM * face.pixels_per_mm)
        return int(np.sum((off > most) & (face.responses > 0.0))) >= SLID_POINTS

    def _spread(self) -> tuple[ToldFace, ...]:
        keys = self._file.sets.keys
        if len(np.unique(keys)) < len(keys):
            return ()
        rows = (
            np.unique(np.linspace(0, len(keys) - 1, IDENTITY_FRAMES).round().astype(int)) if len(keys) else ()
        )
        faces = (self._face(int(row), 0) for row in rows)
        return tuple(face for face in faces if face is not None)

    def _face(self, row: int, stamp_ns: int) -> ToldFace | None:
        """The face of a row of the file; None where its points are no face's before this camera."""
        sets = self._file.sets
        known = np.isfinite(sets.points[row, :, 0]) & (sets.scores[row] > 0.0)
        scores = np.where(known, sets.scores[row], 0.0)
        pixels = reduced_pixels(sets.points[row, :, :2], self._scale)
        try:
            pose, _ = pose_of(pixels, scores * FEATURE_SD.min() / FEATURE_SD, self._camera, FEATURES)
        except ValueError:
            return None
        expected = project((self._camera,), pose.points(FEATURES)).pixels[0]
        filled = np.where(known[:, None], pixels, expected)
        if not np.isfinite(filled).all() or pose.position[2] <= 0.0:
            return None
        return ToldFace(stamp_ns, filled, scores, float(self._camera.fx / pose.position[2]))
