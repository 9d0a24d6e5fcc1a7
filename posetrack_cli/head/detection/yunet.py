"""Faces by YuNet, a small neural network that OpenCV runs from a model file."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.errors import UsageError
from posetrack_cli.files import utf8_name
from posetrack_cli.head.detection.guess import FaceGuess

# YuNet's own threshold for a face is 0.9; it becomes 0.5 as with every finder.
SURE = 0.9
UNSURE = 0.3
# The mouth's corners lie this many eye distances below the eyes (head.md).
MOUTH_BELOW_EYES = 1.09
# In larger images nothing is gained, and time grows with the area.
LONGEST_SIDE = 640


class YunetFaces:
    """Finds faces, eyes and mouths by YuNet.

    Args:
        model: the network's ONNX file.

    Raises:
        UsageError: the file is missing or is not a network that OpenCV can run.
    """

    def __init__(self, model: Path) -> None:
        if not model.is_file():
            raise UsageError("face detector's model not found", where=model)
        try:
            with utf8_name(model) as name:
                self._network = cv2.FaceDetectorYN.create(name, "", (320, 320), score_threshold=UNSURE)
        except cv2.error as error:
            raise UsageError(
                "not a model of YuNet",
                where=model,
                found=error.err,
                expected="an ONNX file of FaceDetectorYN",
            ) from None

    def find(self, image: ImageArray) -> tuple[FaceGuess, ...]:
        """Return the faces in a (height, width) uint8 image, the largest first, also unsure ones."""
        scale = min(1.0, LONGEST_SIDE / max(image.shape))
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        self._network.setInputSize((small.shape[1], small.shape[0]))
        _, rows = self._network.detect(cv2.cvtColor(small, cv2.COLOR_GRAY2BGR))
        faces = [_guess(np.asarray(row, float), scale) for row in ([] if rows is None else rows)]
        return tuple(sorted(faces, key=lambda face: -face.eye_distance))


def _guess(row: FloatArray, scale: float) -> FaceGuess:
    """Read x, y, width, height, then five points (eyes, nose, mouth corners; right first), score."""
    points = row[4:14].reshape(5, 2) / scale
    right, left = points[:2]
    middle, across = (right + left) / 2.0, left - right
    down = points[3:].mean(axis=0) - middle
    distance = max(float(np.hypot(*across)), float(np.hypot(*down)) / MOUTH_BELOW_EYES)
    roll = float(np.arctan2(across[1], across[0]))
    score = 0.5 + 0.5 * (row[14] - SURE) / (1.0 - SURE) if row[14] >= SURE else 0.5 * row[14] / SURE
    return FaceGuess(middle, distance, roll, float(min(score, 1.0)), (right[None], left[None]))
