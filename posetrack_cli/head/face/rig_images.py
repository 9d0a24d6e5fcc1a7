"""The images that the cameras of a rig took at one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.extrinsics import inverse
from posetrack_cli.geometry.projection import in_camera_axes, normalised_from_pixels, pixels_from_points


@dataclass(frozen=True, eq=False)
class CameraImage:
    """One camera's image.

    Attributes:
        camera: with its place.
        image: (height, width) uint8.
    """

    camera: Camera
    image: ImageArray

    def points_at(self, pixels: FloatArray, depths: FloatArray) -> FloatArray:
        """Return the points (..., 3) in the reference's axes seen at pixels and depths, mm."""
        rays = normalised_from_pixels(self.camera, pixels)
        local = np.concatenate([rays, np.ones_like(rays[..., :1])], axis=-1) * depths[..., None]
        back = inverse(np.array(self.camera.camera_T_reference))
        points: FloatArray = local @ back[:, :3].T + back[:, 3]
        return points

    def pixels_of(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return where points (..., 3) in the reference's axes appear, and whether they can."""
        return pixels_from_points(self.camera, in_camera_axes(self.camera, points))


@dataclass(frozen=True, eq=False)
class RigImages:
    """What the cameras of a rig, one or more, saw at one time.

    Attributes:
        cameras: C of them.
        images: (height, width) uint8, one a camera; None where a camera gave none.
    """

    cameras: Sequence[Camera]
    images: Sequence[ImageArray | None]

    @property
    def views(self) -> tuple[CameraImage | None, ...]:
        """Each camera with its image, None where it has none."""
        pairs = zip(self.cameras, self.images, strict=True)
        return tuple(None if image is None else CameraImage(camera, image) for camera, image in pairs)


def is_reference(camera: Camera) -> bool:
    """Whether a camera's axes are the recording's."""
    return bool(np.array_equal(np.array(camera.camera_T_reference), np.eye(3, 4)))


def required(view: CameraImage | None) -> CameraImage:
    """Return a view that is known to be there."""
    if view is None:
        raise ValueError("a camera without an image")
    return view
