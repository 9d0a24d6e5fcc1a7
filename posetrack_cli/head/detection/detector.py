"""Detector of faces and their ten points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.head.config import DetectionSettings
from posetrack_cli.head.detection.appearance import SHIPPED, Appearance, load_appearance
from posetrack_cli.head.detection.finders import (
    MOUTH_BELOW_EYES,
    FaceFinder,
    FaceGuess,
    HaarFaces,
    YunetFaces,
)
from posetrack_cli.head.detection.points import FacePoints, find_points
from posetrack_cli.head.detection.search import (
    Part,
    SearchedImage,
    Way,
    distinct,
    is_elsewhere,
    quick_ways,
    thorough_ways,
    tile_of,
)
from posetrack_cli.head.face.points import EYES, MOUTH

UPRIGHT_RAD = 0.25
"""Maximum roll of a face that is detected without rotating the image."""
CERTAIN, LEAST_UNUSUAL = 0.9, 0.75
"""Score from which a search ends, and minimum of a rolled or turned face: of learned points, half of the
detections between them are false."""
NEAR = 3.0
"""Half the side, in eye distances, of the square searched for a face near an earlier one."""
LEAST_CHANGE, BOX_EYES = 0.6, 2.7
"""Smallest size of that face relative to the earlier one, and width of a cascade's box in eye distances."""
NEAR_AREA = (2.0 * NEAR * 40.0) ** 2
"""Largest area, pixels, of that square: eyes 40 pixels apart suffice for the cascades."""


@dataclass(frozen=True, eq=False)
class Detection:
    """Faces of one image.

    Attributes:
        faces: with their points, certain ones first, then the largest; empty if there is none.
        best_score: 0 to 1, of the best candidate, even if rejected.
    """

    faces: tuple[FacePoints, ...]
    best_score: float


class FaceDetector:
    """Detects faces and their ten points in grey images.

    Args:
        settings: detector and score thresholds.
        twice: locate learned points a second time from where they were found in thorough searches, search
            with a second cascade if there is no face, and prefer certain faces to larger ones **[ours]**.

    Raises:
        UsageError: ``yunet`` without its model file, or an invalid or missing file.
        ResultError: an invalid appearance model.
    """

    def __init__(
        self,
        settings: DetectionSettings = DetectionSettings(),  # noqa: B008
        *,
        twice: bool = True,
    ) -> None:
        self._settings = settings
        self._finder = _finder(settings)
        self._appearance = _appearance(settings)
        self._twice = twice and self._appearance is not None
        # responses of corners say little, so that the first face ends a search
        self._certain = 0.0 if self._appearance is None else CERTAIN

    def detect(self, image: ImageArray, *, wanted: int = 1, roll: float | None = None) -> Detection:
        """Return the faces in a (height, width) uint8 image after a thorough search.

        Args:
            image: grey.
            wanted: number of faces, at most ``limits.FACES``; with fewer that look at the camera, turned and
                rolled ones are searched.
            roll: rad, clockwise, expected roll of the face; None if unknown.
        """
        if roll is not None and abs(roll) <= UPRIGHT_RAD:
            roll = 0.0
        return self._search(image, ((way, None) for way in thorough_ways(roll)), wanted, twice=self._twice)

    def detect_quickly(self, image: ImageArray, index: int, *, wanted: int = 1) -> Detection:
        """Return the faces found in one frame of a long search.

        Args:
            image: grey.
            index: of the frame; consecutive ones are searched in different ways.
            wanted: number of faces, at most ``limits.FACES``.
        """
        upright, other = quick_ways(index)
        tile = tile_of(image.shape, index // 2) if index % 2 else None
        second = (other, None) if tile is None else (upright, tile)
        return self._search(image, ((upright, None), second), wanted)

    def detect_near(self, image: ImageArray, pixels: FloatArray) -> Detection:
        """Return the faces near the place, and of the roll, of an earlier one with points (K, 2)."""
        guess = _guess_at(pixels)
        down = pixels[MOUTH].mean(axis=0) - guess.middle
        reach = NEAR * max(guess.eye_distance, float(np.hypot(*down)) / MOUTH_BELOW_EYES)
        low, high = np.maximum(guess.middle - reach, 0.0), np.maximum(guess.middle + reach + 1.0, 0.0)
        part = (slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0])))
        if not image[part].size:
            return Detection((), 0.0)
        roll = guess.roll if abs(guess.roll) > UPRIGHT_RAD else 0.0
        least = LEAST_CHANGE * reach / NEAR * BOX_EYES / self._settings.least_face_px
        ways = ((Way(turned, roll, NEAR_AREA), part) for turned in (False, True))
        return self._search(image, ways, 1, max(least, 1.0))

    def points_at(self, image: ImageArray, pixels: FloatArray) -> FacePoints | None:
        """Return the points of a face at a known place, None if nothing there resembles a face.

        Args:
            image: grey.
            pixels: (K, 2) approximate points.
        """
        return self._points(image, _guess_at(pixels))

    def _search(
        self,
        image: ImageArray,
        steps: Iterable[tuple[Way, Part | None]],
        wanted: int,
        larger: float = 1.0,
        *,
        twice: bool = False,
    ) -> Detection:
        """Search in several ways until enough faces are certain; keep the best of overlapping ones.

        With ``twice``, points are located a second time from where they were found.
        """
        faces: list[FacePoints] = []
        found: list[FaceGuess] = []
        for way, part in steps:
            if way.again and (faces or not twice):
                break
            searched = replace(SearchedImage.part(image, way.area, part), larger=larger)
            guesses = tuple(searched.faces(self._finder, way))
            found += guesses
            for guess in self._promising(guesses, way, faces, wanted):
                points = self._points(image, guess, way, twice=twice)
                faces = faces if points is None else _with_better(faces, points)
            if sum(face.score >= self._certain for face in faces) >= wanted:
                break
        order = sorted(faces, key=lambda face: (twice and face.score < self._certain, -face.pixels_per_mm))
        return Detection(tuple(order), max((guess.score for guess in found), default=0.0))

    def _promising(
        self, guesses: Sequence[FaceGuess], way: Way, faces: Sequence[FacePoints], wanted: int
    ) -> Sequence[FaceGuess]:
        """Return the guesses whose points are worth locating, which costs as much as a search."""
        sure = [guess for guess in guesses if guess.score >= self._settings.least_face_score]
        certain = [face.guess for face in faces if face.score >= self._certain]
        new = [guess for guess in sure if all(is_elsewhere(guess, one) for one in certain)]
        if way.is_usual:
            return new[: limits.FACES]
        return sorted(distinct(new), key=lambda guess: -guess.score)[:wanted]

    def _points(
        self,
        image: ImageArray,
        guess: FaceGuess,
        way: Way = Way(),  # noqa: B008
        *,
        twice: bool = False,
    ) -> FacePoints | None:
        """Return the points of a face; of an unusual one, only if they look as learned from many faces."""
        found = find_points(image, guess, self._appearance)
        if twice:
            again = find_points(image, found.as_guess, self._appearance)
            found = again if again.misfit_px < found.misfit_px else found
        if not way.is_usual:
            learned = found if self._appearance is not None else find_points(image, guess, load_appearance())
            if learned.score < LEAST_UNUSUAL:
                return None
        return found if found.score >= self._settings.least_point_score else None


def _with_better(faces: Sequence[FacePoints], points: FacePoints) -> list[FacePoints]:
    """Add a face, unless a better one is at its place, and remove worse ones."""
    there = [face for face in faces if not is_elsewhere(points.guess, face.guess)]
    if any(face.score >= points.score for face in there):
        return list(faces)
    return [*(face for face in faces if face not in there), points]


def _guess_at(pixels: FloatArray) -> FaceGuess:
    """Return the face with points (K, 2)."""
    eyes = pixels[EYES].reshape(2, 2, 2).mean(axis=1)
    across = eyes[1] - eyes[0]
    roll = float(np.arctan2(across[1], across[0]))
    between = tuple(eye[None] for eye in eyes)
    return FaceGuess(eyes.mean(axis=0), float(np.hypot(*across)), roll, 1.0, (between[0], between[1]))


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
