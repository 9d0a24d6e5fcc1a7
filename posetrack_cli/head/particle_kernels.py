"""The loops over particles that cost time: where they see the points, what is looked up there; compiled.

Arrays have the particles last, and float32 numbers: 1e-4 px at 1000 px.
"""

from __future__ import annotations

import math

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray
from posetrack_cli.compiled import inlined, kernel

BEHIND = 1e6
"""Normalised coordinate of a point behind a camera: on no image."""
SMALL_ANGLE = 1e-6
"""Below it sin(a)/a and its like are 1 to the last bit."""


@kernel
def write_transforms(
    deviations: FloatArray, rotation: FloatArray, origin: FloatArray, out: Float32Array
) -> None:
    """Write each particle's transform from turned head axes to a camera's: [C exp(w) | C d + o].

    exp(w) = I + A [w] + B [w]^2 with A = sin(a)/a, B = (1 - cos a)/a^2, a = |w|.

    Args:
        deviations: (N, >= 6) d, mm, and w, rad, from a reference pose, as tangent vectors of ``HeadPose``.
        rotation: (3, 3) C, from the reference camera's axes to this one's.
        origin: (3,) o of the head at the reference pose, in this camera's axes, mm.
        out: (12, N) rows of the (3, 4) transforms.
    """
    for n in range(deviations.shape[0]):
        x, y, z = deviations[n, 3], deviations[n, 4], deviations[n, 5]
        angle = max(math.sqrt(x * x + y * y + z * z), SMALL_ANGLE)
        half = math.sin(0.5 * angle) / angle
        a, b = math.sin(angle) / angle, 2.0 * half * half
        e00, e01, e02 = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
        e10, e11, e12 = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
        e20, e21, e22 = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)
        for i in range(3):
            c0, c1, c2 = rotation[i, 0], rotation[i, 1], rotation[i, 2]
            out[4 * i, n] = c0 * e00 + c1 * e10 + c2 * e20
            out[4 * i + 1, n] = c0 * e01 + c1 * e11 + c2 * e21
            out[4 * i + 2, n] = c0 * e02 + c1 * e12 + c2 * e22
            moved = c0 * deviations[n, 0] + c1 * deviations[n, 1] + c2 * deviations[n, 2]
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
def write_normalised(
    shapes: Float32Array, transforms: Float32Array, x: Float32Array, y: Float32Array
) -> None:
    """Write where a camera sees each particle's points, x = X/Z and y = Y/Z before its lens.

    Args:
        shapes: (3K, N) points in turned head axes, mm.
        transforms: (12, N) into the camera's axes.
        x, y: (K, N) out; BEHIND where Z <= 0.
    """
    behind, one = np.float32(BEHIND), np.float32(1.0)
    for k in range(x.shape[0]):
        for n in range(x.shape[1]):
            a, b, c = shapes[3 * k, n], shapes[3 * k + 1, n], shapes[3 * k + 2, n]
            X = transforms[0, n] * a + transforms[1, n] * b + transforms[2, n] * c + transforms[3, n]
            Y = transforms[4, n] * a + transforms[5, n] * b + transforms[6, n] * c + transforms[7, n]
            Z = transforms[8, n] * a + transforms[9, n] * b + transforms[10, n] * c + transforms[11, n]
            in_front = bool(Z > 0.0)
            over = one / (Z if in_front else one)
            x[k, n] = X * over if in_front else behind
            y[k, n] = Y * over if in_front else behind


@inlined
def _bilinear(scores: Float32Array, u: float, v: float) -> float:
    """Interpolate (H, W) at column u in [0, W - 1] and row v in [0, H - 1]."""
    column, row = min(int(u), max(scores.shape[1] - 2, 0)), min(int(v), max(scores.shape[0] - 2, 0))
    right, below = min(column + 1, scores.shape[1] - 1), min(row + 1, scores.shape[0] - 1)
    s, t = u - column, v - row
    upper = (1.0 - s) * scores[row, column] + s * scores[row, right]
    lower = (1.0 - s) * scores[below, column] + s * scores[below, right]
    value: float = (1.0 - t) * upper + t * lower
    return value


@kernel
def add_scores(
    scores: Float32Array,
    left: float,
    top: float,
    u: Float32Array,
    v: Float32Array,
    weight: float,
    between: bool,
    total: FloatArray,
) -> None:
    """Add weight times the score at each particle's pixel; nothing outside the map.

    Args:
        scores: (H, W) of pixels left + column, top + row.
        left, top: pixel of the first score.
        u, v: (N,) pixels.
        weight: of this point.
        between: interpolate bilinearly, else take the nearest score.
        total: (N,) added to.
    """
    last_column, last_row = scores.shape[1] - 1, scores.shape[0] - 1
    for n in range(u.size):
        column, row = u[n] - left, v[n] - top
        if between:
            if 0.0 <= column <= last_column and 0.0 <= row <= last_row:
                total[n] += weight * _bilinear(scores, column, row)
        elif -0.5 <= column < last_column + 0.5 and -0.5 <= row < last_row + 0.5:
            total[n] += weight * scores[int(row + 0.5), int(column + 0.5)]
