"""The loops over particles that cost time: their turns and shapes, and where they see the points; compiled.

Arrays have the particles last, and float32 numbers: 1e-4 px at 1000 px.
"""

from __future__ import annotations

import math

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.geometry.kernels import (
    quaternion_from_vector,
    quaternion_product,
    vector_from_quaternion,
)

BEHIND = 1e6
"""Pixel, or normalised coordinate, of a point behind a camera: on no image."""
_TERMS = (
    11  # of the series of sin(a)/a and (1 - cos a)/a^2: they are left with an error of 1e-9 at half a turn
)
_SIN = np.array([(-1.0) ** i / math.factorial(2 * i + 1) for i in range(_TERMS)], np.float32)
_COS = np.array([(-1.0) ** i / math.factorial(2 * i + 2) for i in range(_TERMS)], np.float32)


@kernel
def recentre(deviations: FloatArray, mean: FloatArray) -> None:
    """Make tangent vectors from a pose those from that pose moved by the mean.

    d - d_m and log(exp(w) exp(-w_m)), d mm and w rad as in ``HeadPose``.

    Args:
        deviations: (N, >= 6), changed in place.
        mean: (>= 6,).
    """
    mx, my, mz, mw = quaternion_from_vector(-mean[3], -mean[4], -mean[5])
    for n in range(deviations.shape[0]):
        for i in range(3):
            deviations[n, i] -= mean[i]
        x, y, z, w = quaternion_from_vector(deviations[n, 3], deviations[n, 4], deviations[n, 5])
        qx, qy, qz, qw = quaternion_product(x, y, z, w, mx, my, mz, mw)
        deviations[n, 3], deviations[n, 4], deviations[n, 5] = vector_from_quaternion(qx, qy, qz, qw)


@kernel
def write_rotations(vectors: Float32Array, out: Float32Array) -> None:
    """Write exp(w) = I + A [w] + B [w]^2, A = sin(a)/a, B = (1 - cos a)/a^2, a = |w| <= pi.

    Args:
        vectors: (3, N) w, rad.
        out: (9, N), the matrices row by row.
    """
    one = np.float32(1.0)
    for n in range(vectors.shape[1]):
        x, y, z = vectors[0, n], vectors[1, n], vectors[2, n]
        square = x * x + y * y + z * z
        a, b = _SIN[_TERMS - 1], _COS[_TERMS - 1]
        for i in range(_TERMS - 2, -1, -1):
            a, b = a * square + _SIN[i], b * square + _COS[i]
        out[0, n], out[4, n], out[8, n] = (
            one - b * (y * y + z * z),
            one - b * (x * x + z * z),
            one - b * (x * x + y * y),
        )
        out[1, n], out[3, n] = b * x * y - a * z, b * x * y + a * z
        out[2, n], out[6, n] = b * x * z + a * y, b * x * z - a * y
        out[5, n], out[7, n] = b * y * z - a * x, b * y * z + a * x


@kernel
def write_transforms(
    shifts: Float32Array,
    rotations: Float32Array,
    to_camera: Float32Array,
    origin: Float32Array,
    out: Float32Array,
) -> None:
    """Write each particle's transform from turned head axes to a camera's: [C exp(w) | C d + o].

    Args:
        shifts: (3, N) d, mm.
        rotations: (9, N) exp(w).
        to_camera: (3, 3) C, from the reference camera's axes to this one's.
        origin: (3,) o of the head at the reference pose, in this camera's axes, mm.
        out: (12, N), the (3, 4) transforms row by row.
    """
    for i in range(3):
        c0, c1, c2 = to_camera[i, 0], to_camera[i, 1], to_camera[i, 2]
        for j in range(3):
            for n in range(shifts.shape[1]):
                out[4 * i + j, n] = c0 * rotations[j, n] + c1 * rotations[3 + j, n] + c2 * rotations[6 + j, n]
        for n in range(shifts.shape[1]):
            moved = c0 * shifts[0, n] + c1 * shifts[1, n] + c2 * shifts[2, n]
            out[4 * i + 3, n] = origin[i] + moved


@kernel
def write_shapes(
    points: Float32Array, directions: Float32Array, coefficients: Float32Array, out: Float32Array
) -> None:
    """Write points + directions a for each particle's coefficients a.

    Args:
        points: (3K,), mm.
        directions: (3K, B).
        coefficients: (B, N), mm.
        out: (3K, N), mm.
    """
    for row in range(points.size):
        for n in range(out.shape[1]):
            out[row, n] = points[row]
        for b in range(directions.shape[1]):
            factor = directions[row, b]
            for n in range(out.shape[1]):
                out[row, n] += factor * coefficients[b, n]


@kernel
def write_pixels(
    shapes: Float32Array,
    transforms: Float32Array,
    intrinsics: Float32Array,
    u: Float32Array,
    v: Float32Array,
) -> None:
    """Write where a pinhole sees each particle's points, u = fx X/Z + cx and v = fy Y/Z + cy.

    Args:
        shapes: (3K, N) points in turned head axes, mm.
        transforms: (12, N) into the camera's axes.
        intrinsics: fx, fy, cx, cy; 1 1 0 0 for normalised coordinates.
        u, v: (K, N) out; BEHIND where Z <= 0.
    """
    behind, one = np.float32(BEHIND), np.float32(1.0)
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    for k in range(u.shape[0]):
        for n in range(u.shape[1]):
            a, b, c = shapes[3 * k, n], shapes[3 * k + 1, n], shapes[3 * k + 2, n]
            X = transforms[0, n] * a + transforms[1, n] * b + transforms[2, n] * c + transforms[3, n]
            Y = transforms[4, n] * a + transforms[5, n] * b + transforms[6, n] * c + transforms[7, n]
            Z = transforms[8, n] * a + transforms[9, n] * b + transforms[10, n] * c + transforms[11, n]
            in_front = bool(Z > 0.0)
            over = one / (Z if in_front else one)
            u[k, n] = fx * (X * over) + cx if in_front else behind
            v[k, n] = fy * (Y * over) + cy if in_front else behind
