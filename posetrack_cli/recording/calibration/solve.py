"""Intrinsics, distortion and places of cameras from views of a board, by OpenCV's calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.rigid import composed, placed
from posetrack_cli.opencv import in_one_thread
from posetrack_cli.recording.calibration.boards import FEWEST_CORNERS
from posetrack_cli.recording.calibration.views import CameraViews

FEWEST_VIEWS = 5
"""Of one camera, or shared by two; good calibrations have 20 and more."""
OUTLIER, OUTLIER_PX = 3.0, 0.5
"""A view counts as wrong if its error is so many times the median one, and more than this."""
NO_K3 = cv2.CALIB_FIX_K3
DISTORTIONS = {
    "none": cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | NO_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "four": NO_K3,
    "five": 0,
    "eight": cv2.CALIB_RATIONAL_MODEL,
}
"""Names by the number of coefficients: k1 k2 p1 p2, k3, k4 k5 k6."""
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)


@dataclass(frozen=True)
class CameraFit:
    """How well one camera's views fit its intrinsics.

    Attributes:
        camera: as it was found, at the place of the reference.
        rms_px: root mean square distance of corners to where they should be.
        used, found, images: views used, boards found, images looked at.
        focal_sd_px: standard deviation of the larger focal length.
    """

    camera: Camera
    rms_px: float
    used: int
    found: int
    images: int
    focal_sd_px: float


def fit_camera(views: CameraViews, distortion: str) -> tuple[CameraFit, CameraViews]:
    """Return one camera's intrinsics and distortion, and the views that were used.

    Views whose error is far above the others' are left out and the rest is fitted again.

    Raises:
        RecordingError: too few views.
    """
    kept = np.array([found is not None for found in views.boards])
    for _ in range(2):
        if kept.sum() < FEWEST_VIEWS:
            raise _too_few(views, int(kept.sum()))
        rms, matrix, coefficients, deviations, errors = _calibrate(views.only(kept), distortion)
        wrong = _outliers(errors)
        if not wrong.any():
            break
        kept[np.flatnonzero(kept)[wrong]] = False
    camera = _camera(views, matrix, coefficients, distortion)
    fit = CameraFit(camera, rms, int(kept.sum()), views.found, views.images, float(deviations[:2].max()))
    return fit, views.only(kept)


def place_cameras(cameras: Sequence[Camera], views: Sequence[CameraViews]) -> list[Camera]:
    """Return the cameras with their places relative to the first.

    One after the other is placed against the camera placed before with which it shares most views, which need
    not be the first.

    Raises:
        RecordingError: a camera shares too few views with any other.
    """
    placed_ones = {0: cameras[0]}
    while len(placed_ones) < len(cameras):
        waiting = [i for i in range(len(cameras)) if i not in placed_ones]
        pairs = [(len(shared_views(views[j], views[i])), -i, -j) for i in waiting for j in placed_ones]
        count, i, j = max(pairs)
        i, j = -i, -j
        if count < FEWEST_VIEWS:
            raise RecordingError(
                f"too few views of the board by camera '{views[i].name}' and another at once",
                found=f"{count} together with '{views[j].name}'",
                expected=f"{FEWEST_VIEWS} at least",
                hint="images of one instant have one name or number in every folder",
            )
        step = _relative(cameras[j], cameras[i], views[j], views[i])
        own = composed(step, np.array(placed_ones[j].camera_T_reference))
        placed_ones[i] = placed(cameras[i], own)
    return [placed_ones[i] for i in range(len(cameras))]


def shared_views(first: CameraViews, second: CameraViews) -> list[tuple[FloatArray, FloatArray, Any]]:
    """Return the corners that two cameras saw at once: pixels (n, 2) in either, and ids, for each instant."""
    shared = []
    for one, two in zip(first.boards, second.boards, strict=True):
        if one is None or two is None:
            continue
        ids, a, b = np.intersect1d(one.ids, two.ids, return_indices=True)
        if len(ids) >= FEWEST_CORNERS:
            shared.append((one.pixels[a], two.pixels[b], ids))
    return shared


@in_one_thread()  # or the last digits would differ by run
def _calibrate(views: CameraViews, distortion: str) -> Any:
    """Return OpenCV's RMS, matrix, coefficients, deviations of intrinsics and errors per view."""
    boards = [found for found in views.boards if found is not None]
    objects = [views.board.points[found.ids].astype(np.float32) for found in boards]
    pixels = [found.pixels.astype(np.float32) for found in boards]
    rms, matrix, coefficients, _, _, deviations, _, errors = cv2.calibrateCameraExtended(
        objects,
        pixels,
        (views.width, views.height),
        None,  # type: ignore[call-overload]
        None,
        flags=DISTORTIONS[distortion],
        criteria=CRITERIA,
    )
    return float(rms), matrix, coefficients.ravel(), deviations.ravel(), errors.ravel()


@in_one_thread()  # or the last digits would differ by run
def _relative(first: Camera, second: Camera, views: CameraViews, others: CameraViews) -> FloatArray:
    """Return second_T_first (3, 4), mm, from shared views with intrinsics as they are."""
    shared = shared_views(views, others)
    for _ in range(2):
        objects = [views.board.points[ids].astype(np.float32) for _, _, ids in shared]
        found = cv2.stereoCalibrateExtended(
            objects,
            [one.astype(np.float32) for one, _, _ in shared],
            [two.astype(np.float32) for _, two, _ in shared],
            first.matrix,
            np.array(first.distortion or (0.0,) * 5),
            second.matrix,
            np.array(second.distortion or (0.0,) * 5),
            (views.width, views.height),
            np.eye(3),
            np.zeros(3),
            flags=cv2.CALIB_FIX_INTRINSIC,
            criteria=CRITERIA,
        )
        rotation, translation, errors = found[5], found[6], found[-1]
        wrong = _outliers(errors.max(axis=1))
        if not wrong.any() or len(shared) - wrong.sum() < FEWEST_VIEWS:
            break
        shared = [view for view, is_wrong in zip(shared, wrong, strict=True) if not is_wrong]
    return np.column_stack([rotation, translation.ravel()])


def _outliers(errors: FloatArray) -> BoolArray:
    limit = max(OUTLIER * float(np.median(errors)), OUTLIER_PX)
    return np.asarray(errors > limit, dtype=bool)


def _camera(views: CameraViews, matrix: FloatArray, coefficients: FloatArray, distortion: str) -> Camera:
    count = {"none": 0, "four": 4, "five": 5, "eight": 8}[distortion]
    return Camera(
        views.width,
        views.height,
        fx=float(matrix[0, 0]),
        fy=float(matrix[1, 1]),
        cx=float(matrix[0, 2]),
        cy=float(matrix[1, 2]),
        distortion=tuple(float(value) for value in coefficients[:count]),
        distortion_model="rational_polynomial" if distortion == "eight" else "plumb_bob",
        name=views.name,
    )


def _too_few(views: CameraViews, count: int) -> RecordingError:
    return RecordingError(
        f"board found in too few images of camera '{views.name}'",
        found=f"{count} of {views.images}",
        expected=f"{FEWEST_VIEWS} at least, of a {views.board.words}",
        hint="--squares counts squares, one more than inner corners in each direction",
    )
