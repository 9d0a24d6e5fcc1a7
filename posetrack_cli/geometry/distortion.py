"""Lens distortion: from points to distorted pixels and back, in OpenCV's models.

Normalised coordinates are x = X/Z, y = Y/Z of a point in the camera's axes, without unit. ``distort`` takes
them to where the lens puts them; pixels follow from the intrinsics, u = fx x' + cx.

Component functions take x and y apart, keep their shape and float type, and cost nothing for a camera without
distortion: what a particle filter projects with.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera

NEWTON_STEPS = 20
CONVERGED = 1e-12
"""Change of a normalised coordinate below which undistortion has arrived: 1e-9 px at fx = 1000."""
SMALL_ANGLE = 1e-8

F: TypeAlias = NDArray[Any]
"""One component of many coordinates, of any floating type."""
Jacobian: TypeAlias = tuple[F, F, F, F]
"""dx'/dx, dx'/dy, dy'/dx, dy'/dy."""


def distort(camera: Camera, x: F, y: F) -> tuple[F, F]:
    """Return where the lens puts normalised coordinates.

    plumb_bob, rational_polynomial: x' = x f(r) + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4, y' alike,
    f = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), then the sensor's tilt.
    equidistant: x' = x/r theta (1 + k1 theta^2 + ... + k4 theta^8), theta = atan r.
    inverse_brown_conrady (librealsense, rsutil.h): the x' whose plumb_bob distortion is x.

    Args:
        camera: whose distortion it is.
        x, y: normalised, one shape; float32 stays float32.
    """
    return _lens(camera).distort(x, y) if camera.is_distorted else (x, y)


def distortion_jacobian(camera: Camera, x: F, y: F) -> Jacobian:
    """Return the derivatives of ``distort`` at normalised coordinates."""
    if not camera.is_distorted:
        one, zero = np.ones_like(x), np.zeros_like(x)
        return one, zero, zero, one
    return _lens(camera).jacobian(x, y)


def undistort(camera: Camera, x: F, y: F) -> tuple[F, F]:
    """Return the normalised coordinates that the lens puts at x, y.

    By Newton's method on ``distort``; of inverse_brown_conrady by its polynomial.

    Coordinates that no point in front of the lens is put at come back as whatever Newton's method ends with.
    """
    if not camera.is_distorted:
        return x, y
    return _lens(camera).undistort(x, y)


def _lens(camera: Camera) -> _Polynomial | _Equidistant | _Inverse:
    """The lens of a camera with distortion; of fourteen coefficients those not given are 0."""
    if camera.distortion_model == "equidistant":
        return _Equidistant(*camera.distortion)
    polynomial = _Polynomial(*camera.distortion, *(0.0,) * (14 - len(camera.distortion)))
    return _Inverse(polynomial) if camera.distortion_model == "inverse_brown_conrady" else polynomial


def _inverted(lens: _Polynomial | _Equidistant, x: F, y: F) -> tuple[F, F]:
    """Return the coordinates that a lens puts at x, y, by Newton's method."""
    found_x, found_y = x, y
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # coefficients of no lens diverge
        for _ in range(NEWTON_STEPS):
            seen_x, seen_y = lens.distort(found_x, found_y)
            step_x, step_y = _solved(lens.jacobian(found_x, found_y), x - seen_x, y - seen_y)
            found_x, found_y = found_x + step_x, found_y + step_y
            if max(np.max(np.abs(step_x), initial=0.0), np.max(np.abs(step_y), initial=0.0)) < CONVERGED:
                break
    return found_x, found_y


class _Polynomial(NamedTuple):
    """Radial and tangential distortion, thin prism and a tilted sensor, as OpenCV has them."""

    k1: float
    k2: float
    p1: float
    p2: float
    k3: float
    k4: float
    k5: float
    k6: float
    s1: float
    s2: float
    s3: float
    s4: float
    tx: float
    ty: float

    def distort(self, x: F, y: F) -> tuple[F, F]:
        xd, yd = self._straight(x, y)
        tilt = self._tilt
        if tilt is None:
            return xd, yd
        (a, b, c), (d, e, f), (g, h, i) = tilt.tolist()
        under = g * xd + h * yd + i
        return (a * xd + b * yd + c) / under, (d * xd + e * yd + f) / under

    def jacobian(self, x: F, y: F) -> Jacobian:
        inner, tilt = self._straight_jacobian(x, y), self._tilt
        if tilt is None:
            return inner
        (a, b, _), (d, e, _), (g, h, i) = tilt.tolist()
        xd, yd = self._straight(x, y)
        xt, yt = self.distort(x, y)
        under = g * xd + h * yd + i
        outer = ((a - g * xt) / under, (b - h * xt) / under, (d - g * yt) / under, (e - h * yt) / under)
        return _product(outer, inner)

    def undistort(self, x: F, y: F) -> tuple[F, F]:
        return _inverted(self, x, y)

    def _radial(self, r2: F) -> tuple[F, F]:
        """Return f(r) and its derivative with respect to r^2."""
        k1, k2, _, _, k3, k4, k5, k6 = self[:8]
        over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3))
        if not (k4 or k5 or k6):
            return over, slope
        under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        under_slope = k4 + r2 * (2.0 * k5 + r2 * (3.0 * k6))
        return over / under, (slope - over / under * under_slope) / under

    def _straight(self, x: F, y: F) -> tuple[F, F]:
        """Where coordinates were put if the sensor were not tilted."""
        p1, p2, s1, s2, s3, s4 = self.p1, self.p2, self.s1, self.s2, self.s3, self.s4
        r2 = x * x + y * y
        f = self._radial(r2)[0]
        xd = x * f + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2)
        yd = y * f + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + s4 * r2)
        return xd, yd

    def _straight_jacobian(self, x: F, y: F) -> Jacobian:
        p1, p2, s1, s2, s3, s4 = self.p1, self.p2, self.s1, self.s2, self.s3, self.s4
        r2 = x * x + y * y
        f, slope = self._radial(r2)
        in_x, in_y = 2.0 * (s1 + 2.0 * s2 * r2), 2.0 * (s3 + 2.0 * s4 * r2)
        cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
        return (
            f + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x + in_x * x,
            cross + in_x * y,
            cross + in_y * x,
            f + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x + in_y * y,
        )

    @property
    def _tilt(self) -> FloatArray | None:
        """The (3, 3) homography of a tilted sensor as in OpenCV; None if it is not tilted."""
        if not (self.tx or self.ty):
            return None
        cx, sx, cy, sy = np.cos(self.tx), np.sin(self.tx), np.cos(self.ty), np.sin(self.ty)
        turn_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
        turn_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
        turn = turn_y @ turn_x
        onto_plane = np.array(
            [[turn[2, 2], 0.0, -turn[0, 2]], [0.0, turn[2, 2], -turn[1, 2]], [0.0, 0.0, 1.0]]
        )
        tilt: FloatArray = onto_plane @ turn
        return tilt


class _Equidistant(NamedTuple):
    """A fisheye, whose radius in the image is a polynomial of the angle."""

    k1: float
    k2: float
    k3: float
    k4: float

    def distort(self, x: F, y: F) -> tuple[F, F]:
        scale = self._scale(x * x + y * y)
        return x * scale, y * scale

    def jacobian(self, x: F, y: F) -> Jacobian:
        k1, k2, k3, k4 = self
        r2 = x * x + y * y
        scale = self._scale(r2)
        t2 = np.arctan(np.sqrt(r2)) ** 2
        rate = (1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * (9 * k4))))) / (1.0 + r2)
        # outwards the scale is ``rate``, across ``scale``
        along = (rate - scale) / np.maximum(r2, SMALL_ANGLE**2)
        return scale + along * x * x, along * x * y, along * x * y, scale + along * y * y

    def undistort(self, x: F, y: F) -> tuple[F, F]:
        return _inverted(self, x, y)

    def _scale(self, r2: F) -> F:
        """Return distorted over undistorted radius; 1 on the axis."""
        k1, k2, k3, k4 = self
        r = np.sqrt(r2)
        theta = np.arctan(r)
        t2 = theta * theta
        distorted = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        scale: F = np.where(r > SMALL_ANGLE, distorted / np.maximum(r, SMALL_ANGLE), r * 0 + 1)
        return scale


class _Inverse(NamedTuple):
    """A lens whose polynomial leads from distorted to undistorted coordinates."""

    polynomial: _Polynomial

    def distort(self, x: F, y: F) -> tuple[F, F]:
        return _inverted(self.polynomial, x, y)

    def jacobian(self, x: F, y: F) -> Jacobian:
        a, b, c, d = self.polynomial.jacobian(*self.distort(x, y))
        determinant = a * d - b * c
        return d / determinant, -b / determinant, -c / determinant, a / determinant

    def undistort(self, x: F, y: F) -> tuple[F, F]:
        return self.polynomial.distort(x, y)


def _product(first: Jacobian, second: Jacobian) -> Jacobian:
    a, b, c, d = first
    e, f, g, h = second
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def _solved(matrix: Jacobian, right_x: F, right_y: F) -> tuple[F, F]:
    """Solve 2x2 systems; where one is singular no step is taken."""
    a, b, c, d = matrix
    determinant = a * d - b * c
    safe = np.where(np.abs(determinant) > 1e-9, determinant, np.inf).astype(determinant.dtype)
    return (d * right_x - b * right_y) / safe, (a * right_y - c * right_x) / safe
