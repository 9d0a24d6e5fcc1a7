"""Dense points of one frame: located in each image, and combined in space **[ours]**."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.head.dense.network import EYE_NETWORK, GAZE_NETWORK, MOUTH_NETWORK, Network
from posetrack_cli.head.dense.points import DENSE_COUNT, EYE_POINTS, MOUTH_POINTS, RIGHT_LIDS
from posetrack_cli.head.dense.regions import (
    LEFT_EYE,
    MOUTH_REGION,
    RIGHT_EYE,
    Region,
    crop,
    gaze_region,
    image_from_crop,
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


_CORNERS = [EYE_POINTS[0].index(RIGHT_LIDS[corner]) for corner in (0, 3)]
CONVERGENCE_RAD, CONVERGENCE_SD_RAD = 0.05, 0.04
"""Usual angle between the eyes, which look at places 1.3 m away, and its standard deviation."""
EYES_ALIKE = 0.3
"""Correlation of both eyes' errors."""


@dataclass(frozen=True, eq=False)
class DensePoints:
    """Dense points of a frame; NaN where no image shows them.

    Attributes:
        places: (D, 3) mm in the head's frame.
        covariances: (D, 3, 3) mm^2.
        gazes: (2, 3) of the right and left eye, each by itself: angles to the subject's left and up, and
            standard deviation, rad.
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
    gazes: tuple[list[FloatArray], list[FloatArray]] = ([], [])
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
            if name == EYE_NETWORK:
                middle = seen.places[_CORNERS].mean(axis=0)
                gazes[int(region.mirrored)].extend(
                    _gaze(networks[GAZE_NETWORK], gaze_region(middle, mirrored=region.mirrored), view, pose)
                )
    known = information[:, 0, 0] > 0.0
    places, covariances = np.full((DENSE_COUNT, 3), np.nan), np.full((DENSE_COUNT, 3, 3), np.nan)
    covariances[known] = np.linalg.inv(information[known])
    places[known] = np.einsum("kij,kj->ki", covariances[known], weighted[known])
    return DensePoints(places, covariances, np.array([_mean_gaze(one) for one in gazes]))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Points of a region in one image: places (P, 3) mm and information (P, 3, 3)."""

    places: FloatArray
    information: FloatArray


def _in_view(
    network: Network, region: Region, view: CameraImage, pose: HeadPose, centre: FloatArray
) -> _Seen | None:
    """Locate a region's points in one image; None if its middle is turned away or outside of it."""
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
    return _Seen(places, information)


def _gaze(network: Network, region: Region, view: CameraImage, pose: HeadPose) -> Iterator[FloatArray]:
    """Yield the gaze (3,) of an eye in one image, if it is inside."""
    homography = image_from_crop(region, pose, view.camera)
    if homography is not None and _is_inside(homography, region, view.image):
        side, up, sd = network.gaze(crop(view.image, homography, region))
        yield np.array([-side if region.mirrored else side, up, sd])


def _mean_gaze(views: Sequence[FloatArray]) -> FloatArray:
    """Return the mean of an eye's gazes (3,); their errors are those of the person, so they do not cancel."""
    if not views:
        return np.full(3, np.nan)
    values = np.array(views)
    weights = values[:, 2] ** -2
    return np.append(weights @ values[:, :2] / weights.sum(), weights.mean() ** -0.5)


def together(gazes: FloatArray) -> FloatArray:
    """Return gazes (2, 3) of eyes that look at one place, given each eye's own estimate.

    Their angles upwards are equal, and they converge by an angle of which something is known before.
    """
    if np.isnan(gazes).any():
        return gazes
    (right, left), variances = gazes[:, :2], gazes[:, 2] ** 2
    share = variances[::-1] / variances.sum()
    known = CONVERGENCE_SD_RAD**2 / (CONVERGENCE_SD_RAD**2 + variances.sum())
    half = 0.5 * (CONVERGENCE_RAD + known * (right[0] - left[0] - CONVERGENCE_RAD))
    ahead = share @ (gazes[:, :2] - [[half, 0.0], [-half, 0.0]])
    sd = np.sqrt(0.5 * (1.0 + EYES_ALIKE) * variances.mean())
    return np.array([[ahead[0] + half, ahead[1], sd], [ahead[0] - half, ahead[1], sd]])


def _camera_centre(camera: Camera, pose: HeadPose) -> FloatArray:
    """Return the camera's centre (3,) in the head's frame, mm."""
    transform = np.array(camera.camera_T_reference)
    centre = -transform[:, :3].T @ transform[:, 3]
    in_head: FloatArray = pose.rotation.T @ (centre - pose.position)
    return in_head


def _is_inside(homography: FloatArray, region: Region, image: ImageArray) -> bool:
    """Whether the middle of a region lies in the image."""
    x, y, w = homography @ (0.5 * region.width, 0.5 * region.height, 1.0)
    height, width = image.shape
    return bool(0.0 <= x / w < width and 0.0 <= y / w < height)


def average_face(networks: Mapping[str, Network]) -> FloatArray:
    """Return the mean face (D, 3), mm, in the head's frame."""
    parts = (
        region.head_from_crop(networks[name].middle[:, :2]) + networks[name].middle[:, 2:] * (0.0, 0.0, 1.0)
        for region, name, _ in _PARTS
    )
    return np.vstack(list(parts))
