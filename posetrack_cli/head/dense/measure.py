"""Dense points of one frame: located in each image, and combined in space **[ours]**."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.dense.network import EYE_NETWORK, LEAST_SD, MOUTH_NETWORK, Located, Network
from posetrack_cli.head.dense.points import DENSE_COUNT, EYE_POINTS, MOUTH_POINTS
from posetrack_cli.head.dense.regions import (
    LEFT_EYE,
    MOUTH_REGION,
    RIGHT_EYE,
    Region,
    crop,
    image_from_crop,
    mapped,
)
from posetrack_cli.head.face.points import HeadPose
from posetrack_cli.head.face.rig_images import CameraImage, RigImages

DEPTH_SD_MM = 2.5
"""Standard deviation of a point's depth from one image, in the head's frame."""
LEAST_FACING = 0.35
"""Minimum cosine between a region's normal and the direction to the camera, about 70 degrees."""
_PARTS: tuple[tuple[Region, str, tuple[int, ...]], ...] = (
    (MOUTH_REGION, MOUTH_NETWORK, MOUTH_POINTS),
    (RIGHT_EYE, EYE_NETWORK, EYE_POINTS[0]),
    (LEFT_EYE, EYE_NETWORK, EYE_POINTS[1]),
)


@dataclass(frozen=True, eq=False)
class DensePoints:
    """Dense points of a frame; NaN where no image shows them.

    Attributes:
        places: (D, 3) mm in the head's frame.
        covariances: (D, 3, 3) mm^2.
        gazes: (2, 3) right and left eye: angles to the subject's left and up, and standard deviation, rad.
    """

    places: FloatArray
    covariances: FloatArray
    gazes: FloatArray

    @property
    def variances(self) -> FloatArray:
        """(D,) mm^2, mean over the axes."""
        mean: FloatArray = np.trace(self.covariances, axis1=1, axis2=2) / 3.0
        return mean


def measure(networks: Mapping[str, Network], images: RigImages, pose: HeadPose) -> DensePoints:
    """Locate the dense points at a tracked pose.

    An image measures a point across its ray precisely, and along the ray as far as faces are alike. The
    estimates of several images are added as information.
    """
    information, weighted = np.zeros((DENSE_COUNT, 3, 3)), np.zeros((DENSE_COUNT, 3))
    gaze_information, gaze = np.zeros((2, 1)), np.zeros((2, 2))
    for view in images.views:
        if view is None:
            continue
        centre = _camera_centre(view.camera, pose)
        start = 0
        for region, name, numbers in _PARTS:
            rows = slice(start, start + len(numbers))
            start = rows.stop
            seen = _in_view(networks[name], region, view, pose, centre)
            if seen is None:
                continue
            information[rows] += seen.information
            weighted[rows] += np.einsum("kij,kj->ki", seen.information, seen.places)
            if seen.gaze is not None:
                side = int(region.mirrored)
                weight = seen.gaze[2] ** -2
                gaze_information[side] += weight
                gaze[side] += weight * seen.gaze[:2]
    known = information[:, 0, 0] > 0.0
    places, covariances = np.full((DENSE_COUNT, 3), np.nan), np.full((DENSE_COUNT, 3, 3), np.nan)
    covariances[known] = np.linalg.inv(information[known])
    places[known] = np.einsum("kij,kj->ki", covariances[known], weighted[known])
    with np.errstate(divide="ignore", invalid="ignore"):
        gazes = np.hstack([gaze / gaze_information, gaze_information**-0.5])
    return DensePoints(places, covariances, np.where(np.isfinite(gazes), gazes, np.nan))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points of a region in one image: places (P, 3) mm, information (P, 3, 3), gaze (3,) of an eye."""

    places: FloatArray
    information: FloatArray
    gaze: FloatArray | None


def _in_view(
    network: Network, region: Region, view: CameraImage, pose: HeadPose, centre: FloatArray
) -> _Seen | None:
    """Locate a region's points in one image; None if the region is turned away or outside of it."""
    towards = centre - np.array(region.centre_mm)
    if towards[2] < LEAST_FACING * float(np.linalg.norm(towards)):
        return None
    homography = image_from_crop(region, pose, view.camera)
    if homography is None or not _is_inside(homography, region, view.image):
        return None
    found = network.locate(crop(view.image, homography, region))
    on_plane = region.head_from_crop(found.pixels)
    rays = on_plane - centre
    places = centre + rays * (rays[:, 2:] + found.depths[:, None]) / rays[:, 2:]
    along = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    outer = along[:, :, None] * along[:, None, :]
    across_sd = found.deviations * region.mm_per_px
    depth_sd = DEPTH_SD_MM / np.abs(along[:, 2])
    information = (np.eye(3) - outer) / np.square(across_sd)[:, None, None]
    information += outer / np.square(depth_sd)[:, None, None]
    return _Seen(places, information, _gaze(found, region))


def _gaze(found: Located, region: Region) -> FloatArray | None:
    if not found.further.size:
        return None
    side, up, log_spread = found.further
    # the spread is that of a Laplace distribution
    sd = np.sqrt(2.0) * (np.exp(log_spread) + LEAST_SD)
    return np.array([-side if region.mirrored else side, up, sd])


def _camera_centre(camera: Camera, pose: HeadPose) -> FloatArray:
    """Return the camera's centre (3,) in the head's frame, mm."""
    transform = np.array(camera.camera_T_reference)
    centre = -transform[:, :3].T @ transform[:, 3]
    in_head: FloatArray = pose.rotation.T @ (centre - pose.position)
    return in_head


def _is_inside(homography: FloatArray, region: Region, image: ImageArray) -> bool:
    """Whether at least half of a region lies in the image."""
    x, y = np.meshgrid(np.linspace(0.0, region.width - 1.0, 6), np.linspace(0.0, region.height - 1.0, 6))
    seen = mapped(homography, np.stack([x, y], axis=-1))
    height, width = image.shape
    inside = (seen >= 0.0).all(axis=-1) & (seen[..., 0] < width) & (seen[..., 1] < height)
    return bool(inside.mean() >= 0.5)


def average_face(networks: Mapping[str, Network]) -> FloatArray:
    """Return the mean face (D, 3), mm, in the head's frame."""
    parts = (
        region.head_from_crop(networks[name].middle[:, :2]) + networks[name].middle[:, 2:] * (0.0, 0.0, 1.0)
        for region, name, _ in _PARTS
    )
    return np.vstack(list(parts))
