"""One camera's part of a picture: its image without lens distortion, and estimates drawn on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray
from posetrack_cli.evaluation.viewing.drawing import Shown
from posetrack_cli.evaluation.viewing.layers import Layer
from posetrack_cli.evaluation.viewing.viewport import Viewport, around_points, largest_viewport, moved_to
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import in_camera_axes, pixels_from_normalised
from posetrack_cli.geometry.rotations import canonical, multiply, quaternions_from_matrices

NO_IMAGE = 40
"""Grey of a picture that the camera did not take."""


class CameraPanel:
    """Draws what one of several cameras saw.

    Args:
        camera: placed relative to that of the estimates.
        points: (N, P, 3) mm, in the axes of the reference camera, that the picture is cut out around; None
            shows the whole image.
        scale: picture pixels per image pixel; None enlarges small pictures.
        still: whether all pictures show the same part, or each is cut out around its own points.
    """

    def __init__(
        self, camera: Camera, points: FloatArray | None, scale: float | None, *, still: bool = True
    ) -> None:
        self._camera = camera
        own = None if points is None else in_camera_axes(camera, points)
        self._still = still or own is None
        if own is None:
            self._viewport = Viewport.enlarged(camera, scale)
        else:
            self._viewport = (around_points if still else largest_viewport)(own, camera, scale)

    def picture(self, image: ImageArray | None, points: FloatArray | None) -> tuple[ImageArray, Camera]:
        """Return the picture (height, width, 3) of a grey image, and the pinhole camera that sees it.

        Args:
            image: (h, w) uint8 as it was taken, None where the camera gave none.
            points: (P, 3) mm, in the axes of the reference camera, that it is cut out around if the part that
                is shown moves.
        """
        viewport = self._viewport
        if not self._still and points is not None:
            viewport = moved_to(viewport, in_camera_axes(self._camera, points), self._camera)
        straight = self._straight(image)
        picture = cv2.cvtColor(np.ascontiguousarray(viewport.cut(straight)), cv2.COLOR_GRAY2BGR)
        return picture, viewport.camera(self._camera)

    def draw(self, picture: ImageArray, camera: Camera, stamp_ns: int, layers: Sequence[Layer]) -> None:
        """Paint estimates with their axes."""
        for layer in layers:
            layer.drawer.draw(picture, camera, seen_from(camera, layer.shown(stamp_ns)), layer.colour)

    def _straight(self, image: ImageArray | None) -> ImageArray:
        """The image without lens distortion."""
        if image is None:
            return np.full((self._camera.height, self._camera.width), NO_IMAGE, dtype=np.uint8)
        if not self._camera.is_distorted:
            return image
        u, v = self._map
        return np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR))

    @cached_property
    def _map(self) -> tuple[Float32Array, Float32Array]:
        """u and v (h, w) in the image as it was taken, for every pixel of one without distortion."""
        camera = self._camera
        v, u = np.mgrid[: camera.height, : camera.width].astype(float)
        normalised = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy], axis=-1)
        pixels = pixels_from_normalised(camera, normalised).astype(np.float32)
        return np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])


def seen_from(camera: Camera, shown: Shown) -> Shown:
    """What is shown, from the reference camera's axes to another's."""
    rotation = np.array(camera.camera_T_reference)[:, :3]
    turned = None
    if shown.quaternion is not None:
        turned = canonical(multiply(quaternions_from_matrices(rotation), shown.quaternion))
    position = None if shown.position is None else in_camera_axes(camera, shown.position)
    points = None if shown.points is None else in_camera_axes(camera, shown.points)
    return replace(shown, position=position, quaternion=turned, points=points)
