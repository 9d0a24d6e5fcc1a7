"""Calibration of cameras from views of a board: intrinsics, extrinsics, bundle adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.errors import RecordingError
from posetrack_cli.files import placed_path
from posetrack_cli.geometry.camera import Camera, in_camera_axes, pixels_wherever
from posetrack_cli.geometry.rigid import CameraPair, composed, inverse, placed, triangulate
from posetrack_cli.opencv import in_one_thread
from posetrack_cli.recording.calibration.views import FEWEST_CORNERS, Board, CameraViews
from posetrack_cli.recording.camera_file import camera_file_text
from posetrack_cli.recording.identity import shown_name

# Bundle adjustment over all cameras and views: maximum likelihood for equal noise in every corner
#
# Cameras that see the same board share its pose, which constrains their focal lengths: a single camera can
# trade focal length for distance.

POSE = 6  # parameters of a pose
STEP = 1e-6  # relative step of central differences, near the optimum eps^(1/3) of float64
TOLERANCE = 1e-9
MOST_STEPS = 60  # consistent views need about ten; inconsistent ones never converge


@dataclass(frozen=True, eq=False)
class JointFit:
    """Cameras after bundle adjustment.

    Attributes:
        cameras: reference first.
        rms_px: (C,) RMS reprojection error of each camera.
        focal_sd_px: (C,) standard deviation of the larger focal length, from the corner residuals.
    """

    cameras: tuple[Camera, ...]
    rms_px: FloatArray
    focal_sd_px: FloatArray


def adjust(cameras: Sequence[Camera], views: Sequence[CameraViews]) -> JointFit:
    """Jointly adjust intrinsics, distortion and extrinsics of the cameras and the board poses.

    Stops after ``MOST_STEPS`` even without convergence, which then shows in the errors.

    Args:
        cameras: initial cameras, reference first.
        views: inlier views of each camera.
    """
    from scipy.optimize import least_squares

    problem = _Problem(cameras, views)
    found = least_squares(
        problem.residuals,
        problem.start(),
        problem.jacobian,
        method="lm",
        x_scale="jac",
        ftol=TOLERANCE,
        xtol=TOLERANCE,
        gtol=TOLERANCE,
        max_nfev=MOST_STEPS,
    )
    adjusted = problem.cameras(found.x)
    squares = np.sum(found.fun.reshape(-1, 2) ** 2, axis=1)
    rms = np.array([np.sqrt(np.mean(squares[problem.camera == c])) for c in range(len(cameras))])
    return JointFit(tuple(adjusted), rms, problem.focal_deviations(found.x, found.fun))


class _Problem:
    """Residuals and Jacobian of the bundle adjustment.

    Parameters: per camera fx fy cx cy, distortion, rotation vector and translation of camera_T_reference
    (fixed for the reference); then per board rotation vector and translation of reference_T_board.
    """

    def __init__(self, cameras: Sequence[Camera], views: Sequence[CameraViews]) -> None:
        self._cameras, self._board = list(cameras), views[0].board
        self._lens = len(cameras[0].distortion)
        self._size = 4 + self._lens + POSE
        every = zip(*(own.boards for own in views), strict=True)
        instants = [index for index, boards in enumerate(every) if any(boards)]
        seen = [
            (c, number, found)
            for c, own in enumerate(views)
            for number, index in enumerate(instants)
            if (found := own.boards[index]) is not None
        ]
        self.camera: IntArray = np.concatenate([np.full(len(f.ids), c) for c, _, f in seen])
        self._view = np.concatenate([np.full(len(f.ids), number) for _, number, f in seen])
        self._points = np.concatenate([self._board.points[f.ids] for _, _, f in seen])
        self._pixels = np.concatenate([f.pixels for _, _, f in seen])
        self._first = {number: (c, f) for c, number, f in reversed(seen)}
        self._views = len(instants)

    def start(self) -> FloatArray:
        """Return the initial parameters; board poses come from the first camera that sees each."""
        parts = [self._packed(camera) for camera in self._cameras]
        for number in range(self._views):
            c, found = self._first[number]
            camera = self._cameras[c]
            lens = np.array(camera.distortion or (0.0,) * 4)
            _, turn, t = cv2.solvePnP(self._board.points[found.ids], found.pixels, camera.matrix, lens)
            own = np.column_stack([cv2.Rodrigues(turn)[0], t])
            parts.append(_vector(composed(inverse(np.array(camera.camera_T_reference)), own)))
        return np.concatenate(parts)

    def cameras(self, x: FloatArray) -> list[Camera]:
        """Return the cameras of a parameter vector."""
        return [
            self._unpacked(camera, own) for camera, own in zip(self._cameras, self._split(x)[0], strict=True)
        ]

    def residuals(self, x: FloatArray) -> FloatArray:
        """Return (2 M,) projected minus detected corners, pixels."""
        boards = self._split(x)[1]
        turns = np.array([cv2.Rodrigues(board[:3])[0] for board in boards])
        points = np.einsum("mij,mj->mi", turns[self._view], self._points) + boards[self._view, 3:]
        projected = np.empty_like(self._pixels)
        for c, camera in enumerate(self.cameras(x)):
            own = self.camera == c
            projected[own] = pixels_wherever(camera, in_camera_axes(camera, points[own]))
        residuals: FloatArray = (projected - self._pixels).ravel()
        return residuals

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Return the (2 M, parameters) Jacobian by central differences.

        A residual depends on one camera and one board only, so the same parameter of all cameras, or of all
        boards, is varied at once.
        """
        jacobian = np.zeros((2 * len(self._pixels), len(x)))
        rows = np.arange(len(jacobian))
        count = len(self._cameras) * self._size
        of_camera, of_board = np.repeat(self.camera * self._size, 2), np.repeat(count + self._view * POSE, 2)
        for columns, offsets, begin, end in (
            (of_camera, range(self._size), 0, count),
            (of_board, range(POSE), count, len(x)),
        ):
            period = len(offsets)
            for k in offsets:
                step = np.zeros_like(x)
                step[begin + k : end : period] = STEP * np.maximum(1.0, np.abs(x[begin + k : end : period]))
                change = self.residuals(x + step) - self.residuals(x - step)
                jacobian[rows, columns + k] = change / (2.0 * step[columns + k])
        jacobian[:, self._size - POSE : self._size] = 0.0  # the reference pose is fixed
        return jacobian

    def focal_deviations(self, x: FloatArray, residuals: FloatArray) -> FloatArray:
        """Return the (C,) standard deviation of the larger of fx and fy: sigma^2 (J^T J)^-1."""
        jacobian = self.jacobian(x)
        free = np.flatnonzero(np.any(jacobian != 0.0, axis=0))
        variance = np.sum(residuals**2) / max(len(residuals) - len(free), 1)
        scale = np.linalg.norm(jacobian[:, free], axis=0)
        inverse_matrix = np.linalg.pinv((jacobian[:, free] / scale).T @ (jacobian[:, free] / scale))
        deviations = np.zeros(len(x))
        deviations[free] = np.sqrt(variance * np.diag(inverse_matrix)) / scale
        return np.array([own[:2].max() for own in self._split(deviations)[0]])

    def _split(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        count = len(self._cameras) * self._size
        return x[:count].reshape(-1, self._size), x[count:].reshape(-1, POSE)

    def _packed(self, camera: Camera) -> FloatArray:
        intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
        return np.concatenate([intrinsics, _vector(np.array(camera.camera_T_reference))])

    def _unpacked(self, camera: Camera, values: FloatArray) -> Camera:
        fx, fy, cx, cy, *lens = values[:-POSE].tolist()
        own = replace(camera, fx=fx, fy=fy, cx=cx, cy=cy, distortion=tuple(lens))
        turn = cv2.Rodrigues(values[-POSE:-3])[0]
        return placed(own, np.column_stack([turn, values[-3:]]))


def _vector(transform: FloatArray) -> FloatArray:
    """Return the rotation vector and translation (6,) of a transform (3, 4)."""
    return np.concatenate([cv2.Rodrigues(transform[:, :3])[0].ravel(), transform[:, 3]])


# Initial intrinsics and extrinsics, by OpenCV's calibration

FEWEST_VIEWS = 5  # of one camera, or shared by two; good calibrations have 20 and more
OUTLIER, OUTLIER_PX = 3.0, 0.5  # a view is an outlier above both: times the median error, and pixels
NO_K3 = cv2.CALIB_FIX_K3
# By number of coefficients: k1 k2 p1 p2, k3, k4 k5 k6.
DISTORTIONS = {
    "none": cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | NO_K3 | cv2.CALIB_ZERO_TANGENT_DIST,
    "four": NO_K3,
    "five": 0,
    "eight": cv2.CALIB_RATIONAL_MODEL,
}
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)


@dataclass(frozen=True)
class CameraFit:
    """Fit of one camera's intrinsics to its views.

    Attributes:
        camera: fitted camera, with the reference's pose.
        rms_px: RMS reprojection error.
        used, found, images: numbers of views used, boards detected, images searched.
        focal_sd_px: standard deviation of the larger focal length.
    """

    camera: Camera
    rms_px: float
    used: int
    found: int
    images: int
    focal_sd_px: float


def fit_camera(views: CameraViews, distortion: str) -> tuple[CameraFit, CameraViews]:
    """Return one camera's intrinsics and distortion, and the inlier views.

    Views with outlying errors are removed and the rest is fitted again.

    Raises:
        RecordingError: there are too few views.
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
    """Return the cameras with extrinsics relative to the first.

    Each camera is placed relative to the already placed camera with which it shares most views, not
    necessarily the first.

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
                f"too few shared board views for camera '{views[i].name}'",
                found=f"{count} shared with '{views[j].name}'",
                expected=f"at least {FEWEST_VIEWS}",
                hint="name simultaneous images equally in every folder",
            )
        step = _relative(cameras[j], cameras[i], views[j], views[i])
        own = composed(step, np.array(placed_ones[j].camera_T_reference))
        placed_ones[i] = placed(cameras[i], own)
    return [placed_ones[i] for i in range(len(cameras))]


def shared_views(first: CameraViews, second: CameraViews) -> list[tuple[FloatArray, FloatArray, Any]]:
    """Return the corners seen by both cameras at each instant: pixels (n, 2) in either, and ids."""
    shared = []
    for one, two in zip(first.boards, second.boards, strict=True):
        if one is None or two is None:
            continue
        ids, a, b = np.intersect1d(one.ids, two.ids, return_indices=True)
        if len(ids) >= FEWEST_CORNERS:
            shared.append((one.pixels[a], two.pixels[b], ids))
    return shared


@in_one_thread()  # threads would make the last digits vary between runs
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


@in_one_thread()  # threads would make the last digits vary between runs
def _relative(first: Camera, second: Camera, views: CameraViews, others: CameraViews) -> FloatArray:
    """Return second_T_first (3, 4), mm, from shared views with fixed intrinsics."""
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
        f"board detected in too few images of camera '{views.name}'",
        found=f"{count} of {views.images}",
        expected=f"at least {FEWEST_VIEWS} with a {views.board.words}",
        hint="check --squares: it counts squares, one more than inner corners in each direction",
    )


# Calibration of a rig, and its quality

DOUBTFUL_PX = 1.0  # larger errors make a calibration unreliable
MISFIT = 3.0  # joint over single-camera error above which, if doubtful, no rig explains the views
DOUBTFUL_FOCAL = 0.02  # relative standard deviation of a focal length, typical of similar views


@dataclass(frozen=True)
class PairError:
    """Quality of the relative pose of two cameras.

    Attributes:
        first, second: names.
        views: instants at which both saw the board.
        epipolar_rms_px, epipolar_p95_px: Sampson distance of corners, RMS and 95th percentile.
        square_mm: mean triangulated side of a square.
        baseline_mm: distance between the cameras.
    """

    first: str
    second: str
    views: int
    epipolar_rms_px: float
    epipolar_p95_px: float
    square_mm: float
    baseline_mm: float


@dataclass(frozen=True)
class StereoCalibration:
    """A calibrated rig and its errors.

    Attributes:
        board: the board.
        cameras: reference first.
        fits: fit of each camera.
        pairs: errors of every two cameras that share views.
        fits_together: True if one rig explains all views; else intrinsics are those of each camera alone.
    """

    board: Board
    cameras: tuple[Camera, ...]
    fits: tuple[CameraFit, ...]
    pairs: tuple[PairError, ...]
    fits_together: bool = True

    def lines(self) -> list[str]:
        """Return results and errors, one line each, for people and as comments of the camera file."""
        return [*map(_camera_line, self.fits), *(_pair_line(pair, self.board) for pair in self.pairs)]

    @property
    def is_inaccurate(self) -> bool:
        """True if an error of a camera or pair is large."""
        errors = [*(fit.rms_px for fit in self.fits), *(pair.epipolar_rms_px for pair in self.pairs)]
        return max(errors) > DOUBTFUL_PX

    def doubts(self) -> list[str]:
        """Return reasons to distrust the calibration; empty if there are none."""
        found = []
        for fit in self.fits:
            if fit.rms_px > DOUBTFUL_PX:
                found.append(f"camera '{fit.camera.name}': large reprojection error of {fit.rms_px:.2f} px")
            if fit.focal_sd_px > DOUBTFUL_FOCAL * fit.camera.fx:
                found.append(
                    f"camera '{fit.camera.name}': focal length is uncertain by {fit.focal_sd_px:.0f} px; "
                    "add views with the board tilted and in every part of the image"
                )
        for pair in self.pairs:
            if pair.epipolar_rms_px > DOUBTFUL_PX:
                found.append(
                    f"'{pair.first}' and '{pair.second}': large epipolar error of "
                    f"{pair.epipolar_rms_px:.2f} px; were images synchronised and the board still?"
                )
        return found

    def file_text(self, source: Path) -> str:
        """Return the text of the camera file, with the errors as comments."""
        title = (
            f"measured by posetrack calibrate stereo on {shown_name(placed_path(source))}, {self.board.words}"
        )
        return camera_file_text(self.cameras, [title, *self.lines()])


def calibrate_stereo(views: Sequence[CameraViews], distortion: str = "four") -> StereoCalibration:
    """Calibrate the cameras that saw a board.

    Intrinsics are fitted to all views of a camera, extrinsics to the views shared by two cameras; both
    initialise a joint bundle adjustment. If the views are not simultaneous, no rig fits and intrinsics keep
    their initial values.

    Args:
        views: views of each camera (``find_views``), reference first.
        distortion: ``none``, ``four`` (k1 k2 p1 p2), ``five`` (and k3) or ``eight`` (rational)
            coefficients.

    Raises:
        RecordingError: there are too few views of the board.
    """
    fitted = [fit_camera(own, distortion) for own in views]
    fits, used = [fit for fit, _ in fitted], [own for _, own in fitted]
    start = place_cameras([fit.camera for fit in fits], used)
    joint = adjust(start, used)
    fits_together = all(
        rms <= max(MISFIT * fit.rms_px, DOUBTFUL_PX) for fit, rms in zip(fits, joint.rms_px, strict=True)
    )
    cameras = joint.cameras if fits_together else tuple(start)
    if fits_together:
        fits = [
            replace(fit, camera=camera, rms_px=float(rms), focal_sd_px=float(sd))
            for fit, camera, rms, sd in zip(fits, cameras, joint.rms_px, joint.focal_sd_px, strict=True)
        ]
    pairs = [
        error
        for i, j in combinations(range(len(cameras)), 2)
        if (error := _pair_error(cameras[i], cameras[j], used[i], used[j]))
    ]
    return StereoCalibration(views[0].board, cameras, tuple(fits), tuple(pairs), fits_together)


def _pair_error(first: Camera, second: Camera, views: CameraViews, others: CameraViews) -> PairError | None:
    shared = shared_views(views, others)
    if not shared:
        return None
    errors = np.concatenate([CameraPair(first, second).epipolar_errors(one, two) for one, two, _ in shared])
    sides = np.concatenate(
        [
            _sides(triangulate([first, second], np.stack([one, two]))[0], ids, views.board)
            for one, two, ids in shared
        ]
    )
    return PairError(
        first.name,
        second.name,
        len(shared),
        float(np.sqrt(np.mean(errors**2))),
        float(np.percentile(errors, 95)),
        float(np.mean(sides)),
        float(np.linalg.norm(CameraPair(first, second).transform[1])),
    )


def _sides(points: FloatArray, ids: FloatArray, board: Board) -> FloatArray:
    """Return the distances, mm, between neighbouring corners of a row."""
    neighbours = (np.diff(ids) == 1) & (ids[1:] % board.across != 0)
    sides: FloatArray = np.linalg.norm(np.diff(points, axis=0), axis=-1)[neighbours]
    return sides


def _camera_line(fit: CameraFit) -> str:
    camera = fit.camera
    return (
        f"camera {camera.name}: reprojection error {fit.rms_px:.3f} px (RMS) in {fit.used} views; board "
        f"detected in {fit.found} of {fit.images} images; fx {camera.fx:.1f} fy {camera.fy:.1f} "
        f"+- {fit.focal_sd_px:.1f} px"
    )


def _pair_line(pair: PairError, board: Board) -> str:
    return (
        f"{pair.first} - {pair.second}: epipolar error {pair.epipolar_rms_px:.3f} px (RMS), "
        f"{pair.epipolar_p95_px:.3f} px (95 %) in {pair.views} views; baseline {pair.baseline_mm:.2f} mm; "
        f"a square of {board.square_mm:g} mm measures {pair.square_mm:.3f} mm"
    )
