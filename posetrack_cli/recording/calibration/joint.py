"""All cameras and all views of a board adjusted together: maximum likelihood for equal noise in every corner.

Cameras that see the same board share its pose, which ties their focal lengths together: alone, each trades
focal length for distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.geometry.projection import in_camera_axes, pixels_wherever
from posetrack_cli.geometry.rigid import composed, inverse, placed
from posetrack_cli.recording.calibration.views import CameraViews

POSE = 6
STEP = 1e-6
"""Relative step of central differences: half of float64's digits and a bit."""
TOLERANCE = 1e-9
MOST_STEPS = 60
"""Views that belong together need about ten; for others no number of steps is enough."""


@dataclass(frozen=True, eq=False)
class JointFit:
    """Cameras after adjustment.

    Attributes:
        cameras: the reference first.
        rms_px: (C,) root mean square distance of each camera's corners to where they should be.
        focal_sd_px: (C,) standard deviation of the larger focal length, from the scatter of the corners.
    """

    cameras: tuple[Camera, ...]
    rms_px: FloatArray
    focal_sd_px: FloatArray


def adjust(cameras: Sequence[Camera], views: Sequence[CameraViews]) -> JointFit:
    """Adjust intrinsics, distortion and places of the cameras and the poses of the board together.

    Ends after ``MOST_STEPS`` if nothing fits, which the errors then tell.

    Args:
        cameras: to start from, the reference first.
        views: of each camera, those that count.
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
    """The corners of all views in one list, and what their residuals depend on.

    Parameters: of each camera fx fy cx cy, distortion, rotation vector and translation of camera_T_reference
    (the reference's are held); then of each board rotation vector and translation of reference_T_board.
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
        """Return the parameters of the cameras, and of boards as the first camera to see each has them."""
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
        """Return the cameras that parameters stand for."""
        return [
            self._unpacked(camera, own) for camera, own in zip(self._cameras, self._split(x)[0], strict=True)
        ]

    def residuals(self, x: FloatArray) -> FloatArray:
        """Return (2 M,) where corners are projected to minus where they were found, pixels."""
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
        """Return (2 M, parameters) derivatives by central differences.

        A residual depends on one camera and one board only, so the same parameter of all cameras, or of all
        boards, is moved at once.
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
        jacobian[:, self._size - POSE : self._size] = 0.0  # the reference stays where it is
        return jacobian

    def focal_deviations(self, x: FloatArray, residuals: FloatArray) -> FloatArray:
        """Return (C,) standard deviation of the larger of fx and fy: sigma^2 (J^T J)^-1."""
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
    """Return rotation vector and translation (6,) of a transform (3, 4)."""
    return np.concatenate([cv2.Rodrigues(transform[:, :3])[0].ravel(), transform[:, 3]])
