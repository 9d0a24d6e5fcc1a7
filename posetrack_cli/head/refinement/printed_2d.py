"""The feature points' own places in one camera's image as the thesis has them (4.42)-(4.52); compiled.

    E = sum over 16 x 16 regions of  rho |I_t(m_t) - I_t-1(m_t-1)|^2 + |I_t(m_t) - I_1(m_1)|^2
        + eps |m_t - m'_t|^2,                              m'_t where the filter's estimate projects to

dm = -D^-1 d, repeated until it is small. **[fix]** (4.51) and (4.52) have the factor 2 of the derivative of
E_I and not that of eps |.|^2: as E is defined, D = (rho + 1) sum K^T K + eps 1 and
d = sum K^T (rho dI + dI_0) + eps (m_t-1 - m'_t).
No point shares an entry of D with another, so it is solved in blocks of two.
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.head.patches import GRID, PATCH, SIZE, normalise, product, sample_grid
from posetrack_cli.head.refinement.joint import CONVERGED_PX
from posetrack_cli.head.refinement.printed import Printed
from posetrack_cli.head.refinement.scene import Scene

REFERENCE, BEFORE = 0, 1
"""Which of ``Scene.raw`` is what."""


@kernel
def recalculate_2d_as_printed(
    scene: Scene,
    expected: FloatArray,
    printed: Printed,
    iterations: int,
    pixels: FloatArray,
    correlations: FloatArray,
) -> None:
    """Descend from pixels (K, 2), which are written over.

    Where a region leaves the image, the point stays where the last step took it.

    Args:
        scene: the frame, of one camera, made for the printed recalculation.
        expected: (K, 2) m'_t, pixels.
        printed: rho and eps, which belong to 8-bit intensities and pixels.
        iterations: steps at most.
        pixels: (K, 2) m of the frame before; out: of this one.
        correlations: (K,) out: the best with a template that is not of the frame before; NaN without one.
    """
    grid, upright, patch = np.empty((GRID, GRID)), np.eye(2), np.empty(SIZE)
    sums = np.empty(5)
    for k in range(len(pixels)):
        for _ in range(iterations):
            if not _sample(scene, pixels[k], upright, grid):
                break
            _regions(scene, k, grid, printed.rho, sums)
            e, f = pixels[k, 0] - expected[k, 0], pixels[k, 1] - expected[k, 1]
            a, b, c = sums[0] + printed.epsilon, sums[1], sums[2] + printed.epsilon
            g, h = sums[3] + printed.epsilon * e, sums[4] + printed.epsilon * f
            determinant = a * c - b * b
            if determinant <= 0.0:
                break
            right, down = (b * h - c * g) / determinant, (b * g - a * h) / determinant
            pixels[k, 0] += right
            pixels[k, 1] += down
            if right * right + down * down < CONVERGED_PX * CONVERGED_PX:
                break
        correlations[k] = np.nan
        if _sample(scene, pixels[k], upright, grid) and normalise(grid, patch) > 0.0:
            correlations[k] = _best(scene, k, patch)


@kernel
def _sample(scene: Scene, pixel: FloatArray, upright: FloatArray, grid: FloatArray) -> bool:
    images = scene.images
    u, v = pixel[0] - images.corners[0, 0], pixel[1] - images.corners[0, 1]
    return sample_grid(images.windows[0], images.sizes[0, 0], images.sizes[0, 1], u, v, upright, grid)


@kernel
def _regions(scene: Scene, k: int, grid: FloatArray, rho: float, sums: FloatArray) -> None:
    """Write what both comparisons add to D (xx, xy, yy) and d (x, y): half the derivatives of E_I."""
    sums[:] = 0.0
    for s in range(2):
        target = scene.raw[s, 0, k]
        if np.isnan(target[0, 0]):
            continue
        weight = 1.0 if s == REFERENCE else rho
        for j in range(1, PATCH + 1):
            for i in range(1, PATCH + 1):
                along = 0.5 * (grid[j, i + 1] - grid[j, i - 1])
                down = 0.5 * (grid[j + 1, i] - grid[j - 1, i])
                difference = grid[j, i] - target[j, i]
                sums[0] += weight * along * along
                sums[1] += weight * along * down
                sums[2] += weight * down * down
                sums[3] += weight * along * difference
                sums[4] += weight * down * difference


@kernel
def _best(scene: Scene, k: int, patch: FloatArray) -> float:
    """Return the best correlation with a template of the sets; NaN where there is none."""
    targets, best = scene.targets, np.nan
    for s in range(targets.stored):
        if targets.weights[s, 0, k] > 0.0:
            ncc = product(patch, targets.patches[s, 0, k])
            if not best > ncc:
                best = ncc
    return best
