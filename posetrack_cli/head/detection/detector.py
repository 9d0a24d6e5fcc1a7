"""Detector of faces and their ten points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.head.config import DetectionSettings
from posetrack_cli.head.detection.appearance import SHIPPED, Appearance, load_appearance
from posetrack_cli.head.detection.finders import (
    ROTATIONS,
    FaceFinder,
    FaceGuess,
    HaarFaces,
    YunetFaces,
    find_rotated,
)
from posetrack_cli.head.detection.points import FacePoints, find_points
from posetrack_cli.head.face.points import EYES

UPRIGHT_RAD = 0.25
"""Maximum roll of a face that is detected without rotating the image."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Faces of one image.

    Attributes:
        faces: with their points, the largest first; empty if there is none.
        best_score: 0 to 1, of the best candidate, even if rejected.
    """

    faces: tuple[FacePoints, ...]
    best_score: float


class FaceDetector:
    """Detects faces and their ten points in grey images.

    Args:
        settings: detector and score thresholds.

    Raises:
        UsageError: ``yunet`` without its model file, or an invalid or missing file.
        ResultError: an invalid appearance model.
    """

    def __init__(self, settings: DetectionSettings = DetectionSettings()) -> None:  # noqa: B008
        self._settings = settings
        self._finder = _finder(settings)
        self._appearance = _appearance(settings)

    def detect(self, image: ImageArray, *, wanted: int = 1, roll: float | None = None) -> Detection:
        """Return the faces in a (height, width) uint8 image.

        Args:
            image: grey.
            wanted: number of faces, at most ``limits.FACES``; if fewer are upright, rotated images are
                searched.
            roll: rad, clockwise, expected roll of the face; None if unknown.
        """
        if roll is not None and abs(roll) > UPRIGHT_RAD:
            guesses = find_rotated(self._finder, image, (roll,))
        else:
            guesses = self._finder.find(image)
        # rotated images only if needed: each costs as much as the upright one
        if roll is None and len(self._sure(guesses)) < wanted:
            guesses = find_rotated(self._finder, image, (0.0, *ROTATIONS))
        found = [find_points(image, guess, self._appearance) for guess in self._sure(guesses)[: limits.FACES]]
        faces = tuple(face for face in found if face.score >= self._settings.least_point_score)
        return Detection(faces, max((guess.score for guess in guesses), default=0.0))

    def points_at(self, image: ImageArray, pixels: FloatArray) -> FacePoints | None:
        """Return the points of a face at a known place, None if nothing there resembles a face.

        Args:
            image: grey.
            pixels: (K, 2) approximate points.
        """
        eyes = pixels[EYES].reshape(2, 2, 2).mean(axis=1)
        across = eyes[1] - eyes[0]
        roll = float(np.arctan2(across[1], across[0]))
        between = tuple(eye[None] for eye in eyes)
        guess = FaceGuess(eyes.mean(axis=0), float(np.hypot(*across)), roll, 1.0, (between[0], between[1]))
        found = find_points(image, guess, self._appearance)
        return found if found.score >= self._settings.least_point_score else None

    def _sure(self, guesses: Sequence[FaceGuess]) -> list[FaceGuess]:
        return [guess for guess in guesses if guess.score >= self._settings.least_face_score]


def _appearance(settings: DetectionSettings) -> Appearance | None:
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
