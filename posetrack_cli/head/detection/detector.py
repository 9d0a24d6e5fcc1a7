"""Faces of an image with their points: what a tracker's start calls."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from posetrack_cli.arrays import ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.head.config import DetectionSettings
from posetrack_cli.head.detection.appearance import SHIPPED, Appearance, load_appearance
from posetrack_cli.head.detection.finders import FaceFinder, HaarFaces, YunetFaces
from posetrack_cli.head.detection.points import FacePoints, find_points


@dataclass(frozen=True, eq=False)
class Detection:
    """What one image holds.

    Attributes:
        faces: with their points, the largest first; empty if there is none.
        best_score: 0 to 1, the surest face's, also of those that were not sure enough.
    """

    faces: tuple[FacePoints, ...]
    best_score: float


class FaceDetector:
    """Finds faces and their ten points in grey images.

    Args:
        settings: which finder, and what is sure enough.

    Raises:
        UsageError: ``yunet`` without its model file, or a file that is none or missing.
        ResultError: a file of features that is none.
    """

    def __init__(self, settings: DetectionSettings = DetectionSettings()) -> None:  # noqa: B008
        self._settings = settings
        self._finder = _finder(settings)
        self._looks = _looks(settings)

    def detect(self, image: ImageArray) -> Detection:
        """Return the faces in a (height, width) uint8 image."""
        guesses = self._finder.find(image)
        sure = [guess for guess in guesses if guess.score >= self._settings.least_face_score]
        found = [find_points(image, guess, self._looks) for guess in sure]
        faces = tuple(face for face in found if face.score >= self._settings.least_point_score)
        return Detection(faces, max((guess.score for guess in guesses), default=0.0))


def _looks(settings: DetectionSettings) -> Appearance | None:
    if settings.points == "corners":
        return None
    return load_appearance(SHIPPED if settings.features is None else Path(settings.features))


def _finder(settings: DetectionSettings) -> FaceFinder:
    if settings.detector == "haar":
        return HaarFaces(settings.least_face_px)
    if settings.model is None:
        raise UsageError(
            "the face detector yunet needs its model", hint="name the ONNX file with --detector-model"
        )
    return YunetFaces(Path(settings.model))
