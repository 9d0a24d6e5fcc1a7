"""Face detectors: OpenCV's Haar cascades, and YuNet, a small neural network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from posetrack_cli import limits
from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import PosetrackError, UsageError
from posetrack_cli.head.detection.model_trial import invalid_model, read_model

NO_EYES = (np.zeros((0, 2)), np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class FaceGuess:
    """A face found by a detector.

    Attributes:
        middle: (2,) pixels, midpoint between the eyes.
        eye_distance: pixels between the eye centres, as if the face looked at the camera.
        roll: rad, clockwise in the image, of the line through the eyes.
        score: 0 to 1; the detector's own threshold is at 0.5.
        yaw: rad, about the camera's y axis, likely one of a head that is turned; 0 for a frontal detector.
        eyes: (n, 2) pixels of candidate centres of the subject's right eye, and of the left eye.
    """

    middle: FloatArray
    eye_distance: float
    roll: float
    score: float
    eyes: tuple[FloatArray, FloatArray] = NO_EYES
    yaw: float = 0.0


class FaceFinder(Protocol):
    """Finds faces in a grey image."""

    def find(self, image: ImageArray, scale: float = 1.0) -> Sequence[FaceGuess]:
        """Return the faces in a (height, width) uint8 image, largest first, also uncertain ones.

        Args:
            image: grey.
            scale: of the image, if reduced; the smallest faces are reduced with it.
        """

    def find_turned(self, image: ImageArray, scale: float = 1.0) -> Sequence[FaceGuess]:
        """Return the faces turned to a side; none if ``find`` returns these."""

    def find_again(self, image: ImageArray, scale: float = 1.0) -> Sequence[FaceGuess]:
        """Return the faces found by other features, in images where ``find`` returns none."""


FACE_CASCADE = "haarcascade_frontalface_alt2.xml"
SECOND_CASCADE = "haarcascade_frontalface_default.xml"
"""Slightly more false detections, and half as many faces missed in dark and noisy images."""
PROFILE_CASCADE = "haarcascade_profileface.xml"
EYE_CASCADE = "haarcascade_eye_tree_eyeglasses.xml"
# Measured on 72 faces, as fractions of the cascade's box.
EYES_MIDDLE = np.array([0.502, 0.402])
EYE_DISTANCE = 0.365
EYE_ROWS = (0.15, 0.62)
EYE_COLUMNS = ((0.0, 0.6), (0.4, 1.0))
EYE_WIDTH = (0.13, 0.43)
# The eye cascade needs large eyes: the box is enlarged to this width.
BOX_WIDTH_FOR_EYES = 300
# Offset of the eye box's centre from the midpoint of the eye corners, in eye distances.
EYE_BOX_OFFSET = np.array([-0.02, -0.04])
NEIGHBOURS_OF_A_FACE = 3
LEAST_BOX_PX = 24
FINE_STEP, COARSE_STEP = 1.1, 1.2
"""Ratio of the sizes at which images, and reduced ones, are searched."""
# The same for the profile cascade, which finds heads turned by 15 to 75 degrees to the left of the image.
PROFILE_ORIGIN = np.array([0.36, 0.447])
PROFILE_EYE_DISTANCE = 0.29
PROFILE_YAW = 0.65


class HaarFaces:
    """The default face detector.

    Args:
        least_width: minimum width of the cascade's box, pixels; it is about 2.7 eye distances wide.

    Raises:
        PosetrackError: this OpenCV has no cascades (OpenCV 5).
    """

    def __init__(self, least_width: int = 50) -> None:
        self._faces, self._profiles = _cascade(FACE_CASCADE), _cascade(PROFILE_CASCADE)
        self._second = _cascade(SECOND_CASCADE)
        self._eyes = _cascade(EYE_CASCADE)
        self._least = least_width

    def find(self, image: ImageArray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        """Return the faces in a (height, width) uint8 image, largest first, also uncertain ones."""
        return tuple(self._guess(image, box, score) for box, score in self._boxes(self._faces, image, scale))

    def find_again(self, image: ImageArray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        """Return the faces that a second cascade finds, largest first, also uncertain ones."""
        return tuple(self._guess(image, box, score) for box, score in self._boxes(self._second, image, scale))

    def find_turned(self, image: ImageArray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        """Return the faces turned to the left or right of the image by 15 to 75 degrees, largest first."""
        mirrored = np.ascontiguousarray(image[:, ::-1])
        left = [_turned(box, score) for box, score in self._boxes(self._profiles, image, scale)]
        right = [_turned(box, score) for box, score in self._boxes(self._profiles, mirrored, scale)]
        last = image.shape[1] - 1.0
        right = [replace(one, middle=one.middle * [-1, 1] + [last, 0.0], yaw=-one.yaw) for one in right]
        return tuple(sorted([*right, *left], key=lambda one: -one.eye_distance))

    def _boxes(self, cascade: Any, image: ImageArray, scale: float) -> list[tuple[FloatArray, float]]:
        """Return boxes x, y, width, height with scores, largest first."""
        least = max(round(scale * self._least), LEAST_BOX_PX)
        step = FINE_STEP if scale == 1.0 else COARSE_STEP
        boxes, neighbours = cascade.detectMultiScale2(
            image, scaleFactor=step, minNeighbors=1, minSize=(least, least)
        )
        found = sorted(zip(boxes, np.ravel(neighbours), strict=True), key=lambda face: -int(face[0][2]))
        return [(np.asarray(box, float), float(n / (n + NEIGHBOURS_OF_A_FACE))) for box, n in found]

    def _guess(self, image: ImageArray, box: FloatArray, score: float) -> FaceGuess:
        distance = EYE_DISTANCE * box[2]
        right, left = (self._eyes_in(image, box, columns) for columns in EYE_COLUMNS)
        offset = EYE_BOX_OFFSET * distance
        eyes = (right - offset, left - offset)
        return FaceGuess(box[:2] + EYES_MIDDLE * box[2:], float(distance), 0.0, score, eyes)

    def _eyes_in(self, image: ImageArray, box: FloatArray, columns: tuple[float, float]) -> FloatArray:
        """Return the centres (n, 2), pixels, of eyes in some columns of a face's box."""
        x, y, width, height = box
        top, bottom = (round(y + part * height) for part in EYE_ROWS)
        left, right = (round(x + part * width) for part in columns)
        corner = np.array([max(left, 0), max(top, 0)])
        part = image[corner[1] : bottom, corner[0] : right]
        scale = BOX_WIDTH_FOR_EYES / width
        enlarged = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
        least, most = (round(fraction * BOX_WIDTH_FOR_EYES) for fraction in EYE_WIDTH)
        boxes = self._eyes.detectMultiScale(
            enlarged, scaleFactor=1.1, minNeighbors=1, minSize=(least, least), maxSize=(most, most)
        )
        found = np.asarray(boxes, dtype=float).reshape(-1, 4)
        centres: FloatArray = (found[:, :2] + found[:, 2:] / 2.0) / scale + corner
        return centres


def _turned(box: FloatArray, score: float) -> FaceGuess:
    middle = box[:2] + PROFILE_ORIGIN * box[2:]
    return FaceGuess(middle, PROFILE_EYE_DISTANCE * float(box[2]), 0.0, score, yaw=PROFILE_YAW)


def _cascade(name: str) -> Any:
    path = Path(cv2.__file__).parent / "data" / name
    cascade = cv2.CascadeClassifier(str(path)) if hasattr(cv2, "CascadeClassifier") else None  # not in 5
    if cascade is None or cascade.empty():
        raise PosetrackError(
            "cannot load OpenCV's Haar cascade",
            where=path.name,
            found=f"OpenCV {cv2.__version__}",
            expected="4.9 or later, below 5",
            hint="reinstall it: pip install --force-reinstall 'opencv-python-headless<5'",
        )
    return cascade


# YuNet's own threshold, which is mapped to a score of 0.5, and the minimum confidence of its candidates.
FACE_THRESHOLD = 0.9
LEAST_SCORE = 0.3
# Distance of the mouth corners below the eyes, in eye distances.
MOUTH_BELOW_EYES = 1.09
# Larger images gain nothing, and the run time grows with the area.
LONGEST_SIDE = 640
FARTHEST_PX = 4.0 * LONGEST_SIDE
"""Limit on coordinates: a network with damaged weights returns arbitrary sizes, or NaN."""


class YunetFaces:
    """Detects faces, eyes and mouths with YuNet.

    Args:
        model: the network's ONNX file.

    Raises:
        UsageError: the file is missing, or OpenCV cannot run the network.
    """

    def __init__(self, model: Path) -> None:
        if not model.is_file():
            raise UsageError("face detector model not found", where=model)
        self._model, data = model, np.frombuffer(read_model(model), np.uint8)
        nothing = np.zeros(0, np.uint8)
        try:
            self._network = cv2.FaceDetectorYN.create(
                "onnx", data, nothing, (320, 320), score_threshold=LEAST_SCORE
            )
        except cv2.error as error:
            raise invalid_model(model, error.err) from None

    def find_turned(self, image: ImageArray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        """Return nothing: ``find`` returns turned heads as well."""
        return ()

    def find_again(self, image: ImageArray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        """Return nothing: the network is the only detector."""
        return ()

    def find(self, image: ImageArray, scale: float = 1.0) -> tuple[FaceGuess, ...]:
        """Return the faces in a (height, width) uint8 image, largest first, also uncertain ones."""
        scale = min(1.0, LONGEST_SIDE / max(image.shape))
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        self._network.setInputSize((small.shape[1], small.shape[0]))
        try:
            _, rows = self._network.detect(cv2.cvtColor(small, cv2.COLOR_GRAY2BGR))
        except cv2.error as error:
            raise invalid_model(self._model, error.err) from None
        found = (
            [] if rows is None else [row for row in rows.astype(float) if np.all(np.abs(row) <= FARTHEST_PX)]
        )
        faces = [face for face in (_guess(row, scale) for row in found) if face.eye_distance >= 1.0]
        surest = sorted(faces, key=lambda face: -face.score)[: limits.GUESSES]
        return tuple(sorted(surest, key=lambda face: -face.eye_distance))


def _guess(row: FloatArray, scale: float) -> FaceGuess:
    """Convert a row: x, y, width, height, five points (eyes, nose, mouth corners; right first), score."""
    points = row[4:14].reshape(5, 2) / scale
    right, left = points[:2]
    middle, across = (right + left) / 2.0, left - right
    down = points[3:].mean(axis=0) - middle
    distance = max(float(np.hypot(*across)), float(np.hypot(*down)) / MOUTH_BELOW_EYES)
    roll = float(np.arctan2(across[1], across[0]))
    score = (
        0.5 + 0.5 * (row[14] - FACE_THRESHOLD) / (1.0 - FACE_THRESHOLD)
        if row[14] >= FACE_THRESHOLD
        else 0.5 * row[14] / FACE_THRESHOLD
    )
    return FaceGuess(middle, distance, roll, float(min(score, 1.0)), (right[None], left[None]))
