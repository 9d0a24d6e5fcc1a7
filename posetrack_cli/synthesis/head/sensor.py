"""The grey cameras of a synthetic recording: where they stand, their lenses and sensors.

One, or two that are toed in; blur, distortion, exposure, noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from posetrack_cli.arrays import Float32Array, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.synthesis.head.options import HeadSynthOptions

EXPOSURE = 245.0
"""Grey value of light 1."""
BLUR_PX = 0.5
READ_SD, SHOT = 1.1, 0.022
"""Noise of a grey value g: variance READ_SD^2 + SHOT g; 2.2 at g = 170."""
BORDER = 0.12
"""Part of the image by which what a distorting lens sees may lie beyond the undistorted image."""

FOCAL_WIDTHS = 1000.0 / 640.0
"""Focal length in image widths: a field of view of 35.5 degrees."""
DISTORTION = (-0.14, 0.06, 0.0006, -0.0004, 0.0)
"""Of the left or only lens; the right one's first two are a tenth smaller."""
NAMES = ("left", "right")


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


def make_cameras(options: HeadSynthOptions) -> tuple[Camera, ...]:
    """Return the cameras, the reference camera first.

    The second one stands ``baseline_mm`` to the right and looks at the place ``distance_mm`` straight ahead
    of the first.
    """
    reference = _camera(options, NAMES[0] if options.cameras == 2 else "camera", DISTORTION)
    if options.cameras == 1:
        return (reference,)
    toe_in = float(np.arctan2(options.baseline_mm, options.distance_mm))
    c, s = np.cos(toe_in), np.sin(toe_in)
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    translation = -rotation @ [options.baseline_mm, 0.0, 0.0]
    rows = np.column_stack([rotation, translation]).tolist()
    other = tuple(0.9 * value for value in DISTORTION[:2]) + DISTORTION[2:]
    return reference, _camera(options, NAMES[1], other, tuple(tuple(row) for row in rows))


def _camera(
    options: HeadSynthOptions,
    name: str,
    distortion: tuple[float, ...],
    transform: tuple[tuple[float, ...], ...] | None = None,
) -> Camera:
    focal = FOCAL_WIDTHS * options.width
    camera = Camera(
        width=options.width,
        height=options.height,
        fx=focal,
        fy=focal,
        cx=(options.width - 1) / 2.0,
        cy=(options.height - 1) / 2.0,
        distortion=distortion if options.distortion else (),
        name=name,
    )
    if transform is None:
        return camera
    from dataclasses import replace

    return replace(camera, camera_T_reference=transform)
