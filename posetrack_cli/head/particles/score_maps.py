"""Compiled kernels of the particle filter: projection of particles, and score maps of templates."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import Float32Array, FloatArray, ImageArray, IntArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.kernels import quaternion_from_vector, quaternion_product, vector_from_quaternion
from posetrack_cli.head.face.templates import LEAST_CONTRAST, PATCH, SIZE

# Rotation, deformation and projection of particles. Particles are the last dimension, in float32: 1e-4 px at
# 1000 px.

BEHIND = 1e6
"""Pixel, or normalised coordinate, of a point behind a camera, outside of any image."""
_TERMS = 11  # of the series of sin(a)/a and (1 - cos a)/a^2, for an error of 1e-9 at half a turn
_SIN = np.array([(-1.0) ** i / math.factorial(2 * i + 1) for i in range(_TERMS)], np.float32)
_COS = np.array([(-1.0) ** i / math.factorial(2 * i + 2) for i in range(_TERMS)], np.float32)


@kernel
def recentre(deviations: FloatArray, mean: FloatArray) -> None:
    """Convert tangent vectors from a pose to tangent vectors from that pose moved by the mean.

    d - d_m and log(exp(w) exp(-w_m)), d mm and w rad as in ``HeadPose``.

    Args:
        deviations: (N, >= 6), modified in place.
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
        origin: (3,) o, origin of the head at the reference pose, in this camera's axes, mm.
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
    """Write the pinhole projections of each particle's points, u = fx X/Z + cx and v = fy Y/Z + cy.

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


# Score maps: correlations of a template at every place of a box.
#
# The thesis correlates for each particle and point (3.3.1). Since all particles see a point within a small
# box of the image, every correlation there is computed once and looked up. The results are the same, and the
# cost depends on the box, not on the number of particles.
#
# A template has PATCH x PATCH pixels, at the offsets (column - 7.5, row - 7.5) from its point. A box
# consists of the first and last columns and rows of the template's top left corner.

HALF = 0.5 * (PATCH - 1)
LARGEST_BOX = 160
"""Maximum side of a box. Larger boxes are cropped about their centre; particles outside score 0."""
MARGIN_PX = 2
"""Margin of a map around its particles, so that it often serves the second weighting as well."""
LEFT, RIGHT, TOP, BOTTOM = range(4)
_STRIDE = 4  # columns of the template that are added at a time
_LEAST_ENERGY = SIZE * LEAST_CONTRAST**2


class ScoreMaps(NamedTuple):
    """Maps of K points in one camera's image.

    Attributes:
        boxes: (K, 4) left, right, top, bottom; empty, right < left, without a map.
        scores: (K, side, side) normalised correlations, -1 to 1, of the template at left + column and top +
            row; valid within the box.
    """

    boxes: IntArray
    scores: Float32Array

    @classmethod
    def of(cls, points: int) -> ScoreMaps:
        """Allocate the maps of this number of points."""
        side = LARGEST_BOX + 2 * MARGIN_PX
        maps = cls(np.zeros((points, 4), np.int64), np.empty((points, side, side), np.float32))
        maps.clear()
        return maps

    def clear(self) -> None:
        """Invalidate the maps for another image."""
        self.boxes[:] = 0, -1, 0, -1


@kernel
def add_all_scores(
    image: ImageArray,
    templates: Float32Array,
    weights: FloatArray,
    u: Float32Array,
    v: Float32Array,
    between: bool,
    boxes: IntArray,
    scores: Float32Array,
    total: FloatArray,
) -> int:
    """Add the weighted scores of each particle's points in an image.

    Args:
        image: (height, width), grey.
        templates: (K, PATCH, PATCH) of zero mean and unit norm.
        weights: (K,); points of weight 0 are skipped.
        u, v: (K, N) pixels.
        between: interpolate bilinearly, otherwise use the nearest score.
        boxes, scores: ``ScoreMaps`` of this image, or empty; recomputed if they do not cover all particles.
        total: (N,) added to.

    Returns:
        Number of maps computed.
    """
    height, width = image.shape
    made, box = 0, np.empty(4, np.int64)
    for k in range(u.shape[0]):
        if weights[k] == 0.0:
            continue
        write_box(u[k], v[k], width, height, LARGEST_BOX, box)
        if box[RIGHT] < box[LEFT] or box[BOTTOM] < box[TOP]:
            continue
        known = boxes[k]
        if not _holds(known, box):
            known[LEFT], known[TOP] = max(box[LEFT] - MARGIN_PX, 0), max(box[TOP] - MARGIN_PX, 0)
            known[RIGHT] = min(box[RIGHT] + MARGIN_PX, width - PATCH)
            known[BOTTOM] = min(box[BOTTOM] + MARGIN_PX, height - PATCH)
            correlate(image, templates[k], known, scores[k])
            made += 1
        add_scores(scores[k], known, u[k], v[k], weights[k], between, total)
    return made


@kernel
def write_box(u: Float32Array, v: Float32Array, width: int, height: int, largest: int, box: IntArray) -> None:
    """Write the box of template corners, within the image, that the particles of a point need.

    Args:
        u, v: (N,) pixels.
        width, height: of the image.
        largest: maximum side; larger boxes are cropped about their centre.
        box: (4,) out, empty if outside the image.
    """
    box[LEFT], box[RIGHT] = _span(u, width, largest)
    box[TOP], box[BOTTOM] = _span(v, height, largest)


@inlined
def _span(pixels: Float32Array, size: int, largest: int) -> tuple[int, int]:
    """Return the first and the last corner for points on an axis of `size` pixels."""
    low, high = _extremes(pixels)
    last = size - PATCH
    first = math.floor(min(max(low - HALF, 0.0), last + 1.0))
    final = math.ceil(max(min(high - HALF, float(last)), -1.0))
    excess = final - first + 1 - largest
    if excess > 0:
        first += excess // 2
        final = first + largest - 1
    return first, final


@inlined
def _extremes(pixels: Float32Array) -> tuple[float, float]:
    """Return the minimum and maximum pixel, inf and -inf if there is none; two at a time.

    NaN, from points outside the lens's range, is ignored because every comparison with it is false.
    """
    a, b = np.float32(np.inf), np.float32(-np.inf)
    c, d = a, b
    for n in range(0, pixels.size - 1, 2):
        one, two = pixels[n], pixels[n + 1]
        a, b = one if one < a else a, one if one > b else b
        c, d = two if two < c else c, two if two > d else d
    last = pixels[pixels.size - 1]  # left over if the number is odd, and otherwise harmless
    a, b = last if last < a else a, last if last > b else b
    return float(min(a, c)), float(max(b, d))


@inlined
def _holds(box: IntArray, other: IntArray) -> bool:
    """Whether this box contains another."""
    across = bool(box[LEFT] <= other[LEFT] and box[RIGHT] >= other[RIGHT])
    return across and bool(box[TOP] <= other[TOP] and box[BOTTOM] >= other[BOTTOM])


@kernel
def correlate(image: ImageArray, template: Float32Array, box: IntArray, scores: Float32Array) -> None:
    """Write the normalised correlations of a template at every place of a box.

    With I' = I - mean of the box, t of zero mean and unit norm and sums over the template's pixels,
    sum t I' / sqrt(sum I'^2 - (sum I')^2 / SIZE). 0 where the image has less contrast than LEAST_CONTRAST.
    Sums of I' and I'^2 are integers below 2^24, which float32 represents exactly.

    Args:
        image: (height, width), grey.
        template: (PATCH, PATCH).
        box: not empty, within the image.
        scores: (>= rows, >= columns of the box) out.
    """
    columns, rows = box[RIGHT] - box[LEFT] + 1, box[BOTTOM] - box[TOP] + 1
    window = _window(image, box)
    sums, squares = np.zeros(window.shape[1], np.float32), np.zeros(window.shape[1], np.float32)
    for y in range(PATCH - 1):
        _add_row(window[y], np.float32(1.0), sums, squares)
    products = np.empty(columns, np.float32)
    for row in range(rows):
        _add_row(window[row + PATCH - 1], np.float32(1.0), sums, squares)
        _write_products(window[row : row + PATCH], template, products)
        s, q = np.float32(0.0), np.float32(0.0)
        for x in range(PATCH - 1):
            s, q = s + sums[x], q + squares[x]
        for column in range(columns):
            s, q = s + sums[column + PATCH - 1], q + squares[column + PATCH - 1]
            energy = float(q) - float(s) * float(s) / SIZE
            scores[row, column] = products[column] / np.sqrt(energy) if energy >= _LEAST_ENERGY else 0.0
            s, q = s - sums[column], q - squares[column]
        _add_row(window[row], np.float32(-1.0), sums, squares)


@kernel
def _window(image: ImageArray, box: IntArray) -> Float32Array:
    """Return the pixels under a template anywhere in a box, minus their rounded mean."""
    width, height = box[RIGHT] - box[LEFT] + PATCH, box[BOTTOM] - box[TOP] + PATCH
    total = 0
    for y in range(height):
        for x in range(width):
            total += image[box[TOP] + y, box[LEFT] + x]
    mean = np.float32(total // (width * height))
    window = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            window[y, x] = np.float32(image[box[TOP] + y, box[LEFT] + x]) - mean
    return window


@inlined
def _add_row(row: Float32Array, sign: np.float32, sums: Float32Array, squares: Float32Array) -> None:
    """Add a row of pixels and their squares to each column's sums, or subtract it."""
    for x in range(row.size):
        sums[x] += sign * row[x]
        squares[x] += sign * row[x] * row[x]


@inlined
def _write_products(window: Float32Array, template: Float32Array, products: Float32Array) -> None:
    """Write the scalar products of a template with each place along PATCH rows of pixels."""
    for column in range(products.size):
        products[column] = np.float32(0.0)
    for y in range(PATCH):
        row, across = window[y], template[y]
        for x in range(0, PATCH, _STRIDE):
            a, b, c, d = across[x], across[x + 1], across[x + 2], across[x + 3]
            for column in range(products.size):
                one, two = a * row[column + x] + b * row[column + x + 1], c * row[column + x + 2]
                products[column] += one + (two + d * row[column + x + 3])


@kernel
def add_scores(
    scores: Float32Array,
    box: IntArray,
    u: Float32Array,
    v: Float32Array,
    weight: float,
    between: bool,
    total: FloatArray,
) -> None:
    """Add the weighted score at each particle's pixel; nothing outside the map.

    Args:
        scores, box: of a map.
        u, v: (N,) pixels.
        weight: of this point.
        between: interpolate bilinearly, otherwise use the nearest score.
        total: (N,) added to.
    """
    left, top = np.float32(box[LEFT] + HALF), np.float32(box[TOP] + HALF)
    last_column, last_row = np.float32(box[RIGHT] - box[LEFT]), np.float32(box[BOTTOM] - box[TOP])
    for n in range(u.size):
        column, row = u[n] - left, v[n] - top
        if between:
            if 0.0 <= column <= last_column and 0.0 <= row <= last_row:
                total[n] += weight * _bilinear(scores, last_column, last_row, column, row)
        elif -0.5 <= column < last_column + 0.5 and -0.5 <= row < last_row + 0.5:
            total[n] += weight * scores[int(row + 0.5), int(column + 0.5)]


@inlined
def _bilinear(
    scores: Float32Array, last_column: np.float32, last_row: np.float32, u: np.float32, v: np.float32
) -> np.float32:
    """Interpolate at column u in [0, last_column] and row v in [0, last_row]."""
    column, row = np.uint32(u), np.uint32(v)
    one = np.float32(1.0)
    right, below = np.uint32(min(u + one, last_column)), np.uint32(min(v + one, last_row))
    s, t = u - np.float32(column), v - np.float32(row)
    upper = scores[row, column] + s * (scores[row, right] - scores[row, column])
    lower = scores[below, column] + s * (scores[below, right] - scores[below, column])
    value: np.float32 = upper + t * (lower - upper)
    return value
