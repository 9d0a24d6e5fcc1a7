"""Faces and eyes by OpenCV's Haar cascades."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import PosetrackError
from posetrack_cli.head.detection.guess import FaceGuess

FACE_CASCADE = "haarcascade_frontalface_alt2.xml"
EYE_CASCADE = "haarcascade_eye_tree_eyeglasses.xml"
# Measured on 72 faces (head.md), as fractions of the cascade's box.
EYES_MIDDLE = np.array([0.502, 0.402])
EYE_DISTANCE = 0.365
EYE_ROWS = (0.15, 0.62)
EYE_COLUMNS = ((0.0, 0.6), (0.4, 1.0))
EYE_WIDTH = (0.13, 0.43)
# Cascades find small eyes badly: the box is enlarged to this width.
BOX_WIDTH_FOR_EYES = 300
# The eye box's middle lies this far, in eye distances, from the middle of the eye's corners.
EYE_BOX_OFFSET = np.array([-0.02, -0.04])
NEIGHBOURS_OF_A_FACE = 3


class HaarFaces:
    """The default face finder.

    Args:
        least_width: pixels; narrower faces are not looked for. The cascade's box is about 2.7 eye distances.
    """

    def __init__(self, least_width: int = 80) -> None:
        self._faces = _cascade(FACE_CASCADE)
        self._eyes = _cascade(EYE_CASCADE)
        self._least = least_width

    def find(self, image: ImageArray) -> tuple[FaceGuess, ...]:
        """Return the faces in a (height, width) uint8 image, the largest first, also unsure ones."""
        least = (self._least, self._least)
        boxes, neighbours = self._faces.detectMultiScale2(
            image, scaleFactor=1.1, minNeighbors=1, minSize=least
        )
        found = sorted(zip(boxes, np.ravel(neighbours), strict=True), key=lambda face: -int(face[0][2]))
        return tuple(self._guess(image, np.asarray(box, float), float(count)) for box, count in found)

    def _guess(self, image: ImageArray, box: FloatArray, neighbours: float) -> FaceGuess:
        score = neighbours / (neighbours + NEIGHBOURS_OF_A_FACE)
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


def _cascade(name: str) -> Any:
    path = Path(cv2.__file__).parent / "data" / name
    cascade = cv2.CascadeClassifier(str(path))
    if cascade.empty():
        raise PosetrackError(
            "OpenCV's Haar cascade cannot be loaded", where=path.name, hint="install opencv-python 4"
        )
    return cascade
