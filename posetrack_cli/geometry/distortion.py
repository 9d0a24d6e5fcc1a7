"""Lens distortion: from points to distorted pixels and back, in OpenCV's models.

Normalised coordinates are x = X/Z, y = Y/Z of a point in the camera's axes, without unit. ``distort`` takes
them to where the lens puts them; pixels follow from the intrinsics, u = fx x' + cx.

Component functions take x and y apart, keep their shape and float type, and cost nothing for a camera without
distortion: what a particle filter projects with.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.camera import Camera

NEWTON_STEPS = 20
CONVERGED = 1e-12
"""Change of a normalised coordinate below which undistortion has arrived: 1e-9 px at fx = 1000."""
SMALL_ANGLE = 1e-8
TILT = slice(12, 14)

F: TypeAlias = NDArray[Any]
"""One component of many coordinates, of any floating type."""
Jacobian: TypeAlias = tuple[F, F, F, F]
"""dx'/dx, dx'/dy, dy'/dx, dy'/dy."""


def distort(camera: Camera, x: F, y: F) -> tuple[F, F]:
    """Return where the lens puts normalised coordinates.

    plumb_bob, rational_polynomial: x' = x f(r) + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4, y' alike,
    f = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), then the sensor's tilt.
    equidistant: x' = x/r theta (1 + k1 theta^2 + ... + k4 theta^8), theta = atan r.

    Args:
        camera: whose distortion it is.
        x, y: normalised, one shape; float32 stays float32.
    """
    if not camera.is_distorted:
        return x, y
    if camera.distortion_model == "equidistant":
        scale = _equidistant_scale(camera, x * x + y * y)
        return x * scale, y * scale
    return _tilted(camera, *_polynomial(camera, x, y))


def distortion_jacobian(camera: Camera, x: F, y: F) -> Jacobian:
    """Return the derivatives of ``distort`` at normalised coordinates."""
    if not camera.is_distorted:
        one, zero = np.ones_like(x), np.zeros_like(x)
        return one, zero, zero, one
    if camera.distortion_model == "equidistant":
        return _equidistant_jacobian(camera, x, y)
    return _tilted_jacobian(camera, x, y, _polynomial_jacobian(camera, x, y))


def undistort(camera: Camera, x: F, y: F) -> tuple[F, F]:
    """Return the normalised coordinates that the lens puts at x, y: Newton's method on ``distort``.

    Coordinates that no point in front of the lens is put at come back as whatever Newton's method ends with.
    """
    if not camera.is_distorted:
        return x, y
    found_x, found_y = x, y
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # coefficients of no lens diverge
        for _ in range(NEWTON_STEPS):
            seen_x, seen_y = distort(camera, found_x, found_y)
            step_x, step_y = _solved(distortion_jacobian(camera, found_x, found_y), x - seen_x, y - seen_y)
            found_x, found_y = found_x + step_x, found_y + step_y
            if max(np.max(np.abs(step_x), initial=0.0), np.max(np.abs(step_y), initial=0.0)) < CONVERGED:
                break
    return found_x, found_y


def _coefficients(camera: Camera) -> tuple[float, ...]:
    """The fourteen coefficients k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tx ty, those not given 0."""
    return camera.distortion + (0.0,) * (14 - len(camera.distortion))


def _radial(camera: Camera, r2: F) -> tuple[F, F]:
    """Return f(r) and its derivative with respect to r^2."""
    k1, k2, _, _, k3, k4, k5, k6 = _coefficients(camera)[:8]
    over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + r2 * (3.0 * k3))
    if not (k4 or k5 or k6):
        return over, slope
    under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    under_slope = k4 + r2 * (2.0 * k5 + r2 * (3.0 * k6))
    return over / under, (slope - over / under * under_slope) / under


def _polynomial(camera: Camera, x: F, y: F) -> tuple[F, F]:
    _, _, p1, p2, _, _, _, _, s1, s2, s3, s4, _, _ = _coefficients(camera)
    r2 = x * x + y * y
    f = _radial(camera, r2)[0]
    xd = x * f + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + s2 * r2)
    yd = y * f + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + s4 * r2)
    return xd, yd


def _polynomial_jacobian(camera: Camera, x: F, y: F) -> Jacobian:
    _, _, p1, p2, _, _, _, _, s1, s2, s3, s4, _, _ = _coefficients(camera)
    r2 = x * x + y * y
    f, slope = _radial(camera, r2)
    in_x, in_y = 2.0 * (s1 + 2.0 * s2 * r2), 2.0 * (s3 + 2.0 * s4 * r2)
    cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    return (
        f + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x + in_x * x,
        cross + in_x * y,
        cross + in_y * x,
        f + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x + in_y * y,
    )


def _tilt(camera: Camera) -> FloatArray | None:
    """Return the (3, 3) homography of a tilted sensor as in OpenCV; None if it is not tilted."""
    about_x, about_y = _coefficients(camera)[TILT]
    if not (about_x or about_y):
        return None
    cx, sx, cy, sy = np.cos(about_x), np.sin(about_x), np.cos(about_y), np.sin(about_y)
    turn_x = np.array([[1.0, 0.0, 0.0], [0.0, cx, sx], [0.0, -sx, cx]])
    turn_y = np.array([[cy, 0.0, -sy], [0.0, 1.0, 0.0], [sy, 0.0, cy]])
    turn = turn_y @ turn_x
    onto_plane = np.array([[turn[2, 2], 0.0, -turn[0, 2]], [0.0, turn[2, 2], -turn[1, 2]], [0.0, 0.0, 1.0]])
    tilt: FloatArray = onto_plane @ turn
    return tilt


def _tilted(camera: Camera, x: F, y: F) -> tuple[F, F]:
    tilt = _tilt(camera)
    if tilt is None:
        return x, y
    (a, b, c), (d, e, f), (g, h, i) = tilt.tolist()
    under = g * x + h * y + i
    return (a * x + b * y + c) / under, (d * x + e * y + f) / under


def _tilted_jacobian(camera: Camera, x: F, y: F, inner: Jacobian) -> Jacobian:
    """Return the Jacobian of tilt after polynomial, given the polynomial's."""
    tilt = _tilt(camera)
    if tilt is None:
        return inner
    (a, b, _), (d, e, _), (g, h, i) = tilt.tolist()
    x, y = _polynomial(camera, x, y)
    xt, yt = _tilted(camera, x, y)
    under = g * x + h * y + i
    outer = ((a - g * xt) / under, (b - h * xt) / under, (d - g * yt) / under, (e - h * yt) / under)
    return _product(outer, inner)


def _equidistant_scale(camera: Camera, r2: F) -> F:
    """Return distorted over undistorted radius; 1 on the axis."""
    r = np.sqrt(r2)
    theta = np.arctan(r)
    scale: F = np.where(
        r > SMALL_ANGLE, _theta_distorted(camera, theta) / np.maximum(r, SMALL_ANGLE), r * 0 + 1
    )
    return scale


def _theta_distorted(camera: Camera, theta: F) -> F:
    k1, k2, k3, k4 = camera.distortion
    t2 = theta * theta
    return theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))


def _equidistant_jacobian(camera: Camera, x: F, y: F) -> Jacobian:
    k1, k2, k3, k4 = camera.distortion
    r2 = x * x + y * y
    scale = _equidistant_scale(camera, r2)
    t2 = np.arctan(np.sqrt(r2)) ** 2
    rate = (1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * (9 * k4))))) / (1.0 + r2)
    along = (rate - scale) / np.maximum(
        r2, SMALL_ANGLE**2
    )  # outwards the scale is ``rate``, across ``scale``
    return scale + along * x * x, along * x * y, along * x * y, scale + along * y * y


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
