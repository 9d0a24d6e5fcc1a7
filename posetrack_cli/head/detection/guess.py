"""Where a face roughly is in an image: what a face detector says of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray

NO_EYES = (np.zeros((0, 2)), np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class FaceGuess:
    """One face that a detector found.

    Attributes:
        middle: (2,) pixels, middle between the eyes.
        eye_distance: pixels between the eyes' centres, as if the face looked at the camera.
        roll: rad, clockwise in the image, of the line through the eyes.
        score: 0 to 1, how sure the detector is; it takes what reaches 0.5.
        eyes: (n, 2) pixels of possible centres of the subject's right eye, and of the left eye.
    """

    middle: FloatArray
    eye_distance: float
    roll: float
    score: float
    eyes: tuple[FloatArray, FloatArray] = NO_EYES


class FaceFinder(Protocol):
    """Finds faces in a grey image."""

    def find(self, image: ImageArray) -> tuple[FaceGuess, ...]:
        """Return the faces in a (height, width) uint8 image, the largest first, also unsure ones."""
