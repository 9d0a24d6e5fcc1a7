"""Square patches of an image as vectors of zero mean and unit norm; compiled.

A patch has ``PATCH`` x ``PATCH`` pixels at the offsets (i - 7.5, j - 7.5) from its centre, i along the rows.
With p = (I - mean I) / |I - mean I| the scalar product of two patches is their normalised correlation (ncc),
and |p - q|^2 = 2 (1 - ncc): a change of brightness or contrast leaves both alone **[ours]**.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, ImageArray
from posetrack_cli.compiled import inlined, kernel

PATCH = 16
SIZE = PATCH * PATCH
GRID = PATCH + 2
"""A patch with one pixel more on each side, for the gradients."""
CENTRE = 0.5 * (GRID - 1)
LEAST_CONTRAST = 1.0
"""Standard deviation, grey levels, below which a patch shows nothing: less than the noise of a camera."""


@inlined
def covers(width: int, height: int, u: float, v: float, warp: FloatArray) -> bool:
    """Whether a warped patch about (u, v), its gradients included, lies within an image."""
    reach_u = CENTRE * (abs(warp[0, 0]) + abs(warp[0, 1]))
    reach_v = CENTRE * (abs(warp[1, 0]) + abs(warp[1, 1]))
    inside_u: bool = u - reach_u >= 0.0 and u + reach_u < width - 1.0
    inside_v: bool = v - reach_v >= 0.0 and v + reach_v < height - 1.0
    return inside_u and inside_v


@kernel
def sample_grid(
    image: ImageArray, width: int, height: int, u: float, v: float, warp: FloatArray, out: FloatArray
) -> bool:
    """Write the intensities at (u, v) + W (i - CENTRE, j - CENTRE), bilinear, into out (GRID, GRID).

    Args:
        image: (>= height, >= width).
        width, height: of the part that may be read.
        u, v: centre, pixels.
        warp: (2, 2) W, pixels of the image per pixel of the patch.
        out: row j, column i.

    Returns:
        Whether all of it lies in the image; else nothing is written.
    """
    if not covers(width, height, u, v, warp):
        return False
    for j in range(GRID):
        for i in range(GRID):
            x = u + warp[0, 0] * (i - CENTRE) + warp[0, 1] * (j - CENTRE)
            y = v + warp[1, 0] * (i - CENTRE) + warp[1, 1] * (j - CENTRE)
            column, row = int(x), int(y)
            s, t = x - column, y - row
            upper = (1.0 - s) * image[row, column] + s * image[row, column + 1]
            lower = (1.0 - s) * image[row + 1, column] + s * image[row + 1, column + 1]
            out[j, i] = (1.0 - t) * upper + t * lower
    return True


@kernel
def normalise(grid: FloatArray, patch: FloatArray) -> float:
    """Write the patch (SIZE,) of a grid (GRID, GRID), zero mean and unit norm; return |I - mean I|.

    A patch without contrast becomes 0 and its norm is returned as 0.
    """
    for j in range(PATCH):
        for i in range(PATCH):
            patch[j * PATCH + i] = grid[j + 1, i + 1]
    mean = total(patch) / SIZE
    for n in range(SIZE):
        patch[n] -= mean
    norm = np.sqrt(product(patch, patch))
    shown = norm >= LEAST_CONTRAST * PATCH
    scale = 1.0 / norm if shown else 0.0
    for n in range(SIZE):
        patch[n] *= scale
    return float(norm) if shown else 0.0


@kernel
def differentiate(grid: FloatArray, patch: FloatArray, norm: float, gradient: FloatArray) -> None:
    """Write dp / dc (2, SIZE), per pixel that the patch's centre c moves along columns and rows of the grid.

    dp = (1 - p p^T) (dI - mean dI) / |I - mean I|, with dI the central differences of neighbouring samples.

    Args:
        grid: (GRID, GRID) intensities.
        patch, norm: of ``normalise``.
        gradient: out.
    """
    for j in range(PATCH):
        for i in range(PATCH):
            gradient[0, j * PATCH + i] = 0.5 * (grid[j + 1, i + 2] - grid[j + 1, i])
            gradient[1, j * PATCH + i] = 0.5 * (grid[j + 2, i + 1] - grid[j, i + 1])
    for axis in range(2):
        slope = gradient[axis]
        mean, along = total(slope) / SIZE, product(slope, patch)
        for n in range(SIZE):
            slope[n] = (slope[n] - mean - along * patch[n]) / norm


@inlined
def product(a: FloatArray, b: FloatArray) -> float:
    """The scalar product of two vectors (SIZE,), in four partial sums: they are added side by side."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    for n in range(0, SIZE, 4):
        s0 += a[n] * b[n]
        s1 += a[n + 1] * b[n + 1]
        s2 += a[n + 2] * b[n + 2]
        s3 += a[n + 3] * b[n + 3]
    return (s0 + s1) + (s2 + s3)


@inlined
def total(a: FloatArray) -> float:
    """The sum of a vector (SIZE,), in four partial sums."""
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    for n in range(0, SIZE, 4):
        s0 += a[n]
        s1 += a[n + 1]
        s2 += a[n + 2]
        s3 += a[n + 3]
    return (s0 + s1) + (s2 + s3)
