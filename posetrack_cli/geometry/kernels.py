"""Compiled rotations of single bodies, shared by the trackers' kernels.

``rotations`` is the vectorised counterpart with the same conventions: quaternions x y z w with the scalar
last, Hamilton product, rotation vectors of axis times angle in radians.
"""

from __future__ import annotations

import math

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import borrowing, inlined

SMALL_SQUARED_ANGLE = 1e-6
"""Below it, three terms of the series in ``rotate_with_jacobian`` are exact to rounding."""
SMALL_SQUARED_SINE = 1e-3
"""Squared half angle or its sine below which four series terms have a relative error of 4e-14."""


@inlined
def quaternion_product(
    ax: float, ay: float, az: float, aw: float, bx: float, by: float, bz: float, bw: float
) -> tuple[float, float, float, float]:
    """Return the Hamilton product a b, with the same operations as ``rotations.multiply``."""
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


@inlined
def quaternion_from_vector(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return the quaternion of a rotation vector."""
    square = 0.25 * (x * x + y * y + z * z)
    if square < SMALL_SQUARED_SINE:
        factor = 0.5 * (1.0 - square / 6.0 * (1.0 - square / 20.0 * (1.0 - square / 42.0)))
        cosine = 1.0 - square / 2.0 * (1.0 - square / 12.0 * (1.0 - square / 30.0 * (1.0 - square / 56.0)))
    else:
        half = math.sqrt(square)
        factor, cosine = 0.5 * math.sin(half) / half, math.cos(half)
    return factor * x, factor * y, factor * z, cosine


@inlined
def vector_from_quaternion(x: float, y: float, z: float, w: float) -> tuple[float, float, float]:
    """Return the rotation vector, of length <= pi, of a unit quaternion of either sign."""
    factor = math.copysign(2.0 * _arc_over_sine(x * x + y * y + z * z, abs(w)), w)
    return factor * x, factor * y, factor * z


@inlined
def _arc_over_sine(square: float, cosine: float) -> float:
    """Return a / sin a for 0 <= a <= pi / 2, from the squared sine and the cosine >= 0."""
    if square < SMALL_SQUARED_SINE:
        return 1.0 + square / 6.0 * (1.0 + square * 9.0 / 20.0 * (1.0 + square * 25.0 / 42.0))
    sine = math.sqrt(square)
    return math.atan2(sine, cosine) / sine


@borrowing
def rotation_matrix(q: FloatArray, out: FloatArray) -> None:
    """Write the matrix (3, 3) of a unit quaternion (4,)."""
    x, y, z, w = q[0], q[1], q[2], q[3]
    out[0, 0], out[0, 1], out[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[1, 0], out[1, 1], out[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[2, 0], out[2, 1], out[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@borrowing
def matrix_product(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Write the product a b of (3, 3) matrices; ``out`` must not alias them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@borrowing
def rotate_in_place(R: FloatArray, w: FloatArray) -> None:
    """Replace R (3, 3) by exp(w) R, applying Rodrigues' formula to its columns.

    v cos a + (n x v) sin a + n (n . v) (1 - cos a), with angle a = |w| and axis n = w / a.
    """
    angle = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    if not angle > 0.0:
        return
    x, y, z, sine, cosine = w[0] / angle, w[1] / angle, w[2] / angle, np.sin(angle), np.cos(angle)
    for j in range(3):
        a, b, c = R[0, j], R[1, j], R[2, j]
        along = (x * a + y * b + z * c) * (1.0 - cosine)
        R[0, j] = a * cosine + (y * c - z * b) * sine + x * along
        R[1, j] = b * cosine + (z * a - x * c) * sine + y * along
        R[2, j] = c * cosine + (x * b - y * a) * sine + z * along


@borrowing
def rotate_with_jacobian(w: FloatArray, R: FloatArray, rotated: FloatArray, left: FloatArray) -> None:
    """Write exp(w) R and the left Jacobian J of d exp(w) = [J dw]_x exp(w), all (3, 3)."""
    squared = w[0] * w[0] + w[1] * w[1] + w[2] * w[2]
    if squared < SMALL_SQUARED_ANGLE:
        a = 1.0 - squared / 6.0 + squared * squared / 120.0
        b = 0.5 - squared / 24.0 + squared * squared / 720.0
        c = 1.0 / 6.0 - squared / 120.0 + squared * squared / 5040.0
    else:
        angle = np.sqrt(squared)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / squared
        c = (1.0 - a) / squared
    for j in range(3):
        _polynomial(w, a, b, R[0, j], R[1, j], R[2, j], rotated[:, j])
        x, y, z = 1.0 if j == 0 else 0.0, 1.0 if j == 1 else 0.0, 1.0 if j == 2 else 0.0
        _polynomial(w, b, c, x, y, z, left[:, j])


@inlined
def _polynomial(w: FloatArray, a: float, b: float, x: float, y: float, z: float, out: FloatArray) -> None:
    """Write v + a w x v + b w x (w x v)."""
    p, q, r = w[1] * z - w[2] * y, w[2] * x - w[0] * z, w[0] * y - w[1] * x
    out[0] = x + a * p + b * (w[1] * r - w[2] * q)
    out[1] = y + a * q + b * (w[2] * p - w[0] * r)
    out[2] = z + a * r + b * (w[0] * q - w[1] * p)
