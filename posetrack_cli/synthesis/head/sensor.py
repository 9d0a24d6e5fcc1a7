"""A grey camera's lens and sensor: blur, distortion, exposure, noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import Float32Array, ImageArray
from posetrack_cli.geometry.camera import Camera

EXPOSURE = 245.0
"""Grey value of light 1."""
BLUR_PX = 0.5
READ_SD, SHOT = 1.1, 0.022
"""Noise of a grey value g: variance READ_SD^2 + SHOT g; 2.2 at g = 170."""
BORDER = 0.12
"""Part of the image by which what a distorting lens sees may lie beyond the undistorted image."""


class Sensor:
    """Makes the 8-bit image of a camera from the light that falls through an ideal lens.

    Args:
        camera: with its distortion.
        noise: factor on the noise's deviation.
    """

    def __init__(self, camera: Camera, noise: float) -> None:
        self.camera = camera
        self._noise = noise
        self.drawn = _drawn_camera(camera) if camera.is_distorted else camera
        self._maps = _distortion_maps(camera, self.drawn) if camera.is_distorted else None

    def image(self, light: Float32Array, rng: np.random.Generator) -> ImageArray:
        """Return the image (height, width) uint8.

        Args:
            light: as ``drawn``, the camera without distortion, sees it.
            rng: draws one number a pixel, whatever the noise.
        """
        import cv2

        if self._maps is not None:
            light = np.asarray(cv2.remap(light, *self._maps, cv2.INTER_LINEAR), dtype=np.float32)
        grey = EXPOSURE * cv2.GaussianBlur(light, (0, 0), BLUR_PX)
        noise = rng.standard_normal(grey.shape, dtype=np.float32)
        sd = np.float32(self._noise) * np.sqrt(np.float32(READ_SD**2) + np.float32(SHOT) * grey)
        codes: ImageArray = np.rint(np.clip(grey + sd * noise, 0.0, 255.0)).astype(np.uint8)
        return codes


def _drawn_camera(camera: Camera) -> Camera:
    """The camera without distortion, with a border."""
    border = round(BORDER * camera.width)
    return replace(
        camera,
        width=camera.width + 2 * border,
        height=camera.height + 2 * border,
        cx=camera.cx + border,
        cy=camera.cy + border,
        distortion=(),
    )


def _distortion_maps(camera: Camera, drawn: Camera) -> tuple[Float32Array, Float32Array]:
    """Where each pixel of the distorted image lies in the drawn one: columns and rows (height, width)."""
    import cv2

    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2).astype(np.float64)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    ideal = cv2.undistortPointsIter(
        pixels, camera.matrix, np.array(camera.distortion), np.eye(3), drawn.matrix, criteria
    )
    maps = ideal.reshape(camera.height, camera.width, 2).astype(np.float32)
    return np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1])
