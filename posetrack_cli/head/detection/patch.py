"""A face's surroundings, brought to one size and upright."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray

PIXELS_PER_MM = 60.0 / 63.0
"""An average face's eyes are 63 mm and 60 pixels apart in a patch."""
WIDTH = HEIGHT = 220
MIDDLE = np.array([110.0, 75.0])
"""Where in a patch the middle between the eyes should lie."""


@dataclass(frozen=True, eq=False)
class FacePatch:
    """A piece of an image of standard size.

    Attributes:
        grey: (HEIGHT, WIDTH) uint8.
        patch_T_image: (2, 3) similarity from pixels of the image to pixels of the patch.
    """

    grey: ImageArray
    patch_T_image: FloatArray

    @property
    def scale(self) -> float:
        """Patch pixels per image pixel."""
        return float(np.hypot(*self.patch_T_image[0, :2]))

    @property
    def roll(self) -> float:
        """Rad, how far the image was turned to make it upright."""
        return float(np.arctan2(self.patch_T_image[0, 1], self.patch_T_image[0, 0]))

    def from_image(self, pixels: FloatArray) -> FloatArray:
        """Return pixels (..., 2) of the image as pixels of the patch."""
        moved: FloatArray = pixels @ self.patch_T_image[:, :2].T + self.patch_T_image[:, 2]
        return moved

    def to_image(self, pixels: FloatArray) -> FloatArray:
        """Return pixels (..., 2) of the patch as pixels of the image."""
        inverse = np.linalg.inv(self.patch_T_image[:, :2])
        moved: FloatArray = (pixels - self.patch_T_image[:, 2]) @ inverse.T
        return moved


def cut_patch(image: ImageArray, middle: FloatArray, pixels_per_mm: float, roll: float) -> FacePatch:
    """Cut the patch of a face whose eyes' middle (2,), scale and roll (rad, clockwise) are about known."""
    scale = PIXELS_PER_MM / pixels_per_mm
    cos, sin = scale * np.cos(roll), scale * np.sin(roll)
    turn = np.array([[cos, sin], [-sin, cos]])
    transform = np.column_stack([turn, MIDDLE - turn @ middle])
    grey = _smoothed(image, scale)
    patch = cv2.warpAffine(
        grey, transform, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return FacePatch(patch, transform)


def _smoothed(image: ImageArray, scale: float) -> ImageArray:
    """Blur an image that is to be made smaller, so that no detail aliases."""
    if scale >= 0.7:
        return image
    return cv2.GaussianBlur(image, (0, 0), 0.5 * np.sqrt(1.0 / scale**2 - 1.0))
