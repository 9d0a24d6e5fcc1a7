"""Pinhole cameras with lens distortion, and projection."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from posetrack_cli.arrays import BoolArray, Float32Array, FloatArray
from posetrack_cli.errors import PosetrackError

# Pinhole cameras with lens distortion.
#
# Pixel coordinates follow OpenCV: the centre of the first pixel is (0, 0).


DISTORTION_LENGTHS = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
    "inverse_brown_conrady": (4, 5),
}
# Beyond any real camera; within these limits no arithmetic on pixels overflows.
SMALLEST_FOCAL_PX, LARGEST_PX, LARGEST_COEFFICIENT = 0.1, 1e6, 1e6
# p2, thin prism s1 and s2, sensor tilt about y: their terms in x' are even in x
_CHANGE_SIGN_IN_A_MIRROR = (3, 8, 9, 13)
IN_PLACE = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
"""Transform of the reference camera."""


@dataclass(frozen=True)
class Camera:
    """Calibrated camera: u = fx x/z + cx, v = fy y/z + cy, after lens distortion.

    Attributes:
        width, height: image size, pixels.
        fx, fy, cx, cy: intrinsics, pixels.
        distortion: coefficients in OpenCV's order; empty for none.
        distortion_model: ``plumb_bob`` (k1 k2 p1 p2 k3), ``rational_polynomial``, ``equidistant`` or
            ``inverse_brown_conrady`` (plumb_bob's polynomial, from distorted to undistorted coordinates).
        name: frame id or folder name; used in result topics.
        camera_T_reference: (3, 4) transform from the recording's reference camera, mm.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    name: str = "camera"
    camera_T_reference: tuple[tuple[float, ...], ...] = IN_PLACE

    def __post_init__(self) -> None:
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        focal_lengths = min(self.fx, self.fy) >= SMALLEST_FOCAL_PX
        if not all(np.isfinite(values)) or max(np.abs(values[:4])) > LARGEST_PX or not focal_lengths:
            raise PosetrackError(
                "invalid intrinsics",
                where=self.name,
                found=f"fx {self.fx} fy {self.fy} cx {self.cx} cy {self.cy}",
                expected=f"finite values up to {LARGEST_PX:g}, fx and fy at least {SMALLEST_FOCAL_PX:g} px",
            )
        if self.width <= 0 or self.height <= 0:
            raise PosetrackError("invalid image size", where=self.name, found=f"{self.width}x{self.height}")
        if max(np.abs(self.distortion), default=0.0) > LARGEST_COEFFICIENT:
            raise PosetrackError(
                "invalid distortion",
                where=self.name,
                found=f"coefficients {' '.join(f'{value:g}' for value in self.distortion)}",
                expected=f"up to {LARGEST_COEFFICIENT:g}",
            )
        lengths = DISTORTION_LENGTHS.get(self.distortion_model)
        if self.distortion and (lengths is None or len(self.distortion) not in lengths):
            raise PosetrackError(
                "invalid distortion",
                where=self.name,
                found=f"{self.distortion_model} with {len(self.distortion)} coefficients",
                expected="; ".join(f"{k} with {v}" for k, v in DISTORTION_LENGTHS.items()),
            )

    @property
    def matrix(self) -> FloatArray:
        """Intrinsic matrix K (3, 3), pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def values(self) -> dict[str, Any]:
        """Return name, size, intrinsics and distortion as plain values, for records and JSON."""
        keys = ("name", "width", "height", "fx", "fy", "cx", "cy", "distortion", "distortion_model")
        return {key: getattr(self, key) for key in keys} | {"distortion": list(self.distortion)}

    @property
    def is_distorted(self) -> bool:
        """Whether any distortion coefficient is non-zero."""
        return any(self.distortion)

    def scaled(self, width: int, height: int) -> Camera:
        """Return the camera of the same image at another resolution: cx' = (cx + 1/2) s - 1/2."""
        across, down = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * across,
            fy=self.fy * down,
            cx=(self.cx + 0.5) * across - 0.5,
            cy=(self.cy + 0.5) * down - 0.5,
        )

    def mirrored(self) -> Camera:
        """Return the camera of the horizontally flipped image: cx' = width - 1 - cx.

        If all cameras are mirrored, they see the mirrored scene, x to -x in the reference axes.
        """
        signs = [-1.0 if k in _CHANGE_SIGN_IN_A_MIRROR else 1.0 for k in range(len(self.distortion))]
        if self.distortion_model == "equidistant":
            signs = [1.0] * len(signs)
        distortion = tuple(sign * value for sign, value in zip(signs, self.distortion, strict=True))
        flip = (-1.0, 1.0, 1.0)
        rows = tuple(
            tuple(s * v * r + 0.0 for v, r in zip(row, (*flip, 1.0), strict=True))  # + 0.0: no -0.0
            for s, row in zip(flip, self.camera_T_reference, strict=True)
        )
        return replace(self, cx=self.width - 1 - self.cx, distortion=distortion, camera_T_reference=rows)

    def pixels_from_points(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Project without distortion.

        Args:
            points: (..., 3) in camera coordinates, mm.

        Returns:
            (..., 2) pixels, and (...) whether the point lies in front of the camera.
        """
        z = points[..., 2]
        valid = z > 0.0
        safe = np.where(valid, z, 1.0)
        u = self.fx * points[..., 0] / safe + self.cx
        v = self.fy * points[..., 1] / safe + self.cy
        return np.stack([u, v], axis=-1), valid

    def points_from_pixels(self, pixels: FloatArray, depth: FloatArray) -> FloatArray:
        """Back-project undistorted pixels (..., 2) with depth z (...) mm to (..., 3) points, mm."""
        x = (pixels[..., 0] - self.cx) / self.fx * depth
        y = (pixels[..., 1] - self.cy) / self.fy * depth
        return np.stack([x, y, np.broadcast_to(depth, x.shape)], axis=-1)


# Lens distortion: from points to distorted pixels and back, in OpenCV's models.
#
# Normalised coordinates are x = X/Z, y = Y/Z of a point in camera axes, without unit. ``distort`` maps them
# to distorted coordinates, and the intrinsics map these to pixels, u = fx x' + cx.
#
# Functions take x and y as separate arrays, keep shape and float type, and return at once for cameras without
# distortion, as particle filters call them for every pose.

NEWTON_STEPS = 20
CONVERGED = 1e-12
"""Convergence threshold of undistortion in normalised coordinates: 1e-9 px at fx = 1000."""
SMALL_ANGLE = 1e-8

F: TypeAlias = NDArray[Any]
"""One component of many coordinates, of any float type."""
Jacobian: TypeAlias = tuple[F, F, F, F]
"""dx'/dx, dx'/dy, dy'/dx, dy'/dy."""


def distort(camera: Camera, x: F, y: F) -> tuple[F, F]:
    """Return the distorted coordinates of normalised ones.

    plumb_bob, rational_polynomial: x' = x f(r) + 2 p1 x y + p2 (r^2 + 2 x^2) + s1 r^2 + s2 r^4, y'
    likewise, f = (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), then the sensor tilt.
    equidistant: x' = x/r theta (1 + k1 theta^2 + ... + k4 theta^8), theta = atan r.
    inverse_brown_conrady (librealsense, rsutil.h): the x' whose plumb_bob distortion is x.

    Args:
        camera: camera with the distortion.
        x, y: normalised coordinates of equal shape; float32 stays float32.
    """
    return _lens(camera).distort(x, y) if camera.is_distorted else (x, y)


def distortion_jacobian(camera: Camera, x: F, y: F) -> Jacobian:
    """Return the derivatives of ``distort`` at normalised coordinates."""
    if not camera.is_distorted:
        one, zero = np.ones_like(x), np.zeros_like(x)
        return one, zero, zero, one
    return _lens(camera).jacobian(x, y)


def undistort(camera: Camera, x: F, y: F) -> tuple[F, F]:
    """Return the normalised coordinates of distorted ones.

    Uses Newton's method on ``distort``, or the polynomial of inverse_brown_conrady. Coordinates outside the
    range of ``distort`` give arbitrary results.
    """
    if not camera.is_distorted:
        return x, y
    return _lens(camera).undistort(x, y)


def _lens(camera: Camera) -> _Polynomial | _Equidistant | _Inverse:
    """Return the lens model; missing polynomial coefficients are 0."""
    if camera.distortion_model == "equidistant":
        return _Equidistant(*camera.distortion)
    polynomial = _Polynomial(*camera.distortion, *(0.0,) * (14 - len(camera.distortion)))
    return _Inverse(polynomial) if camera.distortion_model == "inverse_brown_conrady" else polynomial


def _inverted(lens: _Polynomial | _Equidistant, x: F, y: F) -> tuple[F, F]:
    """Invert a lens by Newton's method."""
    found_x, found_y = x, y
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # unrealistic coefficients diverge
        for _ in range(NEWTON_STEPS):
            seen_x, seen_y = lens.distort(found_x, found_y)
            step_x, step_y = _solved(lens.jacobian(found_x, found_y), x - seen_x, y - seen_y)
            found_x, found_y = found_x + step_x, found_y + step_y
            if max(np.max(np.abs(step_x), initial=0.0), np.max(np.abs(step_y), initial=0.0)) < CONVERGED:
                break
    return found_x, found_y


class _Polynomial(NamedTuple):
    """Radial, tangential and thin prism distortion and sensor tilt, as in OpenCV."""

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
        """Return the distorted coordinates before sensor tilt."""
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
        """Homography (3, 3) of a tilted sensor as in OpenCV; None without tilt."""
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
    """Fisheye lens whose image radius is a polynomial of the angle."""

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
        """Return distorted divided by undistorted radius; 1 on the axis."""
        k1, k2, k3, k4 = self
        r = np.sqrt(r2)
        theta = np.arctan(r)
        t2 = theta * theta
        distorted = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        scale: F = np.where(r > SMALL_ANGLE, distorted / np.maximum(r, SMALL_ANGLE), r * 0 + 1)
        return scale


class _Inverse(NamedTuple):
    """Lens whose polynomial maps distorted to undistorted coordinates."""

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
    """Solve 2x2 systems; singular ones give a step of zero."""
    a, b, c, d = matrix
    determinant = a * d - b * c
    safe = np.where(np.abs(determinant) > 1e-9, determinant, np.inf).astype(determinant.dtype)
    return (d * right_x - b * right_y) / safe, (a * right_y - c * right_x) / safe


# Projection into cameras with lens distortion, and back.
#
# ``Camera.pixels_from_points`` is the same without distortion. With several cameras, points are in the axes
# of the recording's reference camera, and ``in_camera_axes`` transforms them to another's.

WIDEST_TAN, RADII = 4.0, 4001
"""Distortion is checked up to 76 degrees off the axis, in steps of 0.001 of the tangent."""


def in_camera_axes(camera: Camera, points: FloatArray) -> FloatArray:
    """Transform points (..., 3), mm, from the reference camera's axes to this camera's: R p + t."""
    transform = np.array(camera.camera_T_reference)
    moved: FloatArray = points @ transform[:, :3].T + transform[:, 3]
    return moved


def pixels_from_points(camera: Camera, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Project with lens distortion.

    Args:
        camera: the camera.
        points: (..., 3) in the camera's own axes, mm.

    Returns:
        (..., 2) pixels, and (...) whether the point is in front of the camera and within the angle up to
        which distorted radii increase; beyond it polynomials fold back into the image.
    """
    normalised = _normalised(points)
    radius = np.hypot(normalised[..., 0], normalised[..., 1])
    valid = (points[..., 2] > 0.0) & (radius < largest_radius(camera))
    return pixels_from_normalised(camera, normalised), valid


def pixels_wherever(camera: Camera, points: FloatArray) -> FloatArray:
    """Return the pixels (..., 2) of ``pixels_from_points`` without checking visibility.

    For use with many cameras and few points, where determining each camera's valid angle would dominate.
    """
    return pixels_from_normalised(camera, _normalised(points))


def _normalised(points: FloatArray) -> FloatArray:
    """Return normalised coordinates (..., 2) of points (..., 3), finite even behind the camera."""
    z = np.where(points[..., 2] > 0.0, points[..., 2], 1.0)
    return points[..., :2] / z[..., None]


def pixels_and_jacobian(camera: Camera, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distorted pixels (..., 2) of points (..., 3) in camera axes, and their derivatives.

    Returns:
        Pixels, and (..., 2, 3) derivatives with respect to the points, pixels per mm. Points must be in
        front of the camera.
    """
    x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
    lens = np.array(distortion_jacobian(camera, x, y)).reshape(2, 2, *x.shape)
    lens *= np.array([camera.fx, camera.fy]).reshape(2, 1, *[1] * x.ndim)
    by_x, by_y = lens[:, 0] / points[..., 2], lens[:, 1] / points[..., 2]
    jacobian = np.stack([by_x, by_y, -(by_x * x + by_y * y)], axis=1)
    pixels = pixels_from_normalised(camera, np.stack([x, y], axis=-1))
    return pixels, np.moveaxis(jacobian, (0, 1), (-2, -1))


def pixels_from_normalised(camera: Camera, normalised: FloatArray) -> FloatArray:
    """Return distorted pixels (..., 2) of normalised coordinates (..., 2)."""
    x, y = distort(camera, normalised[..., 0], normalised[..., 1])
    pixels = np.empty((*x.shape, 2), x.dtype)
    pixels[..., 0], pixels[..., 1] = camera.fx * x + camera.cx, camera.fy * y + camera.cy
    return pixels


def normalised_from_pixels(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return normalised coordinates (..., 2) of distorted pixels (..., 2), i.e. rays (x, y, 1)."""
    x = (pixels[..., 0] - camera.cx) / camera.fx
    y = (pixels[..., 1] - camera.cy) / camera.fy
    return np.stack(undistort(camera, x, y), axis=-1)


def undistorted_pixels(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return the pixels (..., 2) of an undistorted camera with the same intrinsics."""
    if not camera.is_distorted:
        return pixels
    flat: FloatArray = normalised_from_pixels(camera, pixels) * [camera.fx, camera.fy]
    flat += [camera.cx, camera.cy]
    return flat


def pixel_map(target: Camera, source: Camera) -> tuple[Float32Array, Float32Array]:
    """Return u and v (height, width) in the source image for every pixel of the target image.

    The cameras share position and axes, but differ in intrinsics, distortion and size.
    """
    v, u = np.mgrid[: target.height, : target.width].astype(float)
    rays = normalised_from_pixels(target, np.stack([u, v], axis=-1))
    pixels = pixels_from_normalised(source, rays).astype(np.float32)
    return np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])


@lru_cache(maxsize=64)
def largest_radius(camera: Camera) -> float:
    """Return the largest sqrt(x^2 + y^2) up to which distorted radii increase; inf if they always do.

    Checked along both axes in both directions, up to ``WIDEST_TAN``.
    """
    if not camera.is_distorted:
        return float("inf")
    radii = np.linspace(0.0, WIDEST_TAN, RADII)
    zero = np.zeros_like(radii)
    with np.errstate(all="ignore"):
        along_x = [distortion_jacobian(camera, sign * radii, zero)[0] for sign in (1.0, -1.0)]
        along_y = [distortion_jacobian(camera, zero, sign * radii)[3] for sign in (1.0, -1.0)]
    grows = np.all(np.array(along_x + along_y) > 0.0, axis=0)
    return float("inf") if grows.all() else float(radii[np.argmin(grows)])
