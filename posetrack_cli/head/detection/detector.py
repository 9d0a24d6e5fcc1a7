"""Faces of an image with their points: what a tracker's start calls."""

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
    TURNS,
    FaceFinder,
    FaceGuess,
    HaarFaces,
    YunetFaces,
    find_turned,
)
from posetrack_cli.head.detection.points import FacePoints, find_points
from posetrack_cli.head.face.points import EYES

UPRIGHT = 0.25
"""Rad: a face turned less in the image is found as it is."""


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

    def detect(self, image: ImageArray, *, wanted: int = 1, roll: float | None = None) -> Detection:
        """Return the faces in a (height, width) uint8 image.

        Args:
            image: grey.
            wanted: so many faces are looked for, at most ``limits.FACES``: where fewer are upright, turned
                ones are, too.
            roll: rad, clockwise, how the face is turned that is looked for; None where that is not known.
        """
        if roll is not None and abs(roll) > UPRIGHT:
            guesses = find_turned(self._finder, image, (roll,))
        else:
            guesses = self._finder.find(image)
        if roll is None and len(self._sure(guesses)) < wanted:
            guesses = find_turned(self._finder, image, (0.0, *TURNS))
        found = [find_points(image, guess, self._looks) for guess in self._sure(guesses)[: limits.FACES]]
        faces = tuple(face for face in found if face.score >= self._settings.least_point_score)
        return Detection(faces, max((guess.score for guess in guesses), default=0.0))

    def points_at(self, image: ImageArray, pixels: FloatArray) -> FacePoints | None:
        """Return the points of a face that is known to be there, None where nothing looks like one.

        Args:
            image: grey.
            pixels: (K, 2) roughly where its points are.
        """
        eyes = pixels[EYES].reshape(2, 2, 2).mean(axis=1)
        across = eyes[1] - eyes[0]
        roll = float(np.arctan2(across[1], across[0]))
        between = tuple(eye[None] for eye in eyes)
        guess = FaceGuess(eyes.mean(axis=0), float(np.hypot(*across)), roll, 1.0, (between[0], between[1]))
        found = find_points(image, guess, self._looks)
        return found if found.score >= self._settings.least_point_score else None

    def _sure(self, guesses: Sequence[FaceGuess]) -> list[FaceGuess]:
        return [guess for guess in guesses if guess.score >= self._settings.least_face_score]


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
