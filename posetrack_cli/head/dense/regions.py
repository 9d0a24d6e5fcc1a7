"""Regions of the face that are cut from an image at the tracked pose **[ours]**.

A region is a rectangle in a plane z = const of the head's frame. Its crop is that rectangle as seen by the
camera, so that size, rotation and perspective are removed. The left eye is mirrored: both eyes look alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_wherever
from posetrack_cli.head.face.points import HeadPose


@dataclass(frozen=True)
class Region:
    """Rectangle of the head's frame, parallel to its x and y axes.

    Attributes:
        name: of the region.
        centre_mm: x, y, z of its centre in the head's frame.
        mm_per_px: size of a pixel of the crop.
        width, height: of the crop, pixels.
        mirrored: whether the crop's columns run to the subject's right instead of left.
    """

    name: str
    centre_mm: tuple[float, float, float]
    mm_per_px: float
    width: int
    height: int
    mirrored: bool = False

    def head_from_crop(self, pixels: FloatArray) -> FloatArray:
        """Return places (..., 3) mm in the head's frame of crop pixels (..., 2)."""
        middle = 0.5 * np.array([self.width - 1.0, self.height - 1.0])
        direction = np.array([-1.0 if self.mirrored else 1.0, -1.0]) * self.mm_per_px
        across = (pixels - middle) * direction
        offset = np.concatenate([across, np.zeros_like(across[..., :1])], axis=-1)
        places: FloatArray = offset + np.array(self.centre_mm)
        return places

    def corners(self) -> tuple[FloatArray, FloatArray]:
        """Return the crop's corner pixels (4, 2), and their places (4, 3) in the head's frame."""
        right, bottom = self.width - 1.0, self.height - 1.0
        pixels = np.array([[0.0, 0.0], [right, 0.0], [right, bottom], [0.0, bottom]])
        return pixels, self.head_from_crop(pixels)


MOUTH_REGION = Region("mouth", (0.0, -82.0, 12.0), 1.45, 80, 88)
RIGHT_EYE = Region("right_eye", (-35.0, 14.0, 4.0), 1.1, 56, 56)
LEFT_EYE = Region("left_eye", (35.0, 14.0, 4.0), 1.1, 56, 56, mirrored=True)
REGIONS = (MOUTH_REGION, RIGHT_EYE, LEFT_EYE)


def gaze_region(middle: FloatArray, *, mirrored: bool) -> Region:
    """Return the region of an eye, given the middle (3,) of its corners, mm in the head's frame."""
    x, y, z = middle.tolist()
    return Region("gaze", (x, y, z), 0.75, 48, 28, mirrored)


def image_from_crop(region: Region, pose: HeadPose, camera: Camera) -> FloatArray | None:
    """Return the homography (3, 3) from crop to image pixels; None for a region behind the camera.

    ``pose`` is in the reference camera's axes. Within a region, lens distortion is linear enough.
    """
    pixels, places = region.corners()
    points = in_camera_axes(camera, pose.points(places))
    if points[:, 2].min() <= 1.0:
        return None
    seen = pixels_wherever(camera, points)
    return np.asarray(cv2.getPerspectiveTransform(pixels.astype(np.float32), seen.astype(np.float32)))


def crop(image: ImageArray, homography: FloatArray, region: Region) -> ImageArray:
    """Return the region's crop (height, width); small pixels of the image are averaged."""
    scale = float(np.sqrt(abs(np.linalg.det(homography[:2, :2]))))
    if scale <= MINIFIED:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = (region.width, region.height)
        return cv2.warpPerspective(image, homography, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    finer = int(np.ceil(scale / MINIFIED))
    shrink = np.array([[1 / finer, 0, 0.5 / finer - 0.5], [0, 1 / finer, 0.5 / finer - 0.5], [0, 0, 1.0]])
    large = cv2.warpPerspective(
        image,
        homography @ shrink,
        (region.width * finer, region.height * finer),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return cv2.resize(large, (region.width, region.height), interpolation=cv2.INTER_AREA)


MINIFIED = 1.5
"""Image pixels per crop pixel from which image pixels are averaged instead of interpolated."""
