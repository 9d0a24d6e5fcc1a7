"""The feature points' own places as the thesis has them (3.3)-(3.19); compiled.

    E = sum over cameras and 16 x 16 regions of  rho |I_t(m_t) - I_t-1(m_t-1)|^2 + |I_t(m_t) - I_1(m_1)|^2
        + eps |M'_t - M_t|^2,                                     m = P(p_t, M')

dM = -D^-1 d, repeated. **[fix]** (3.16) has the factor 2 of the derivative of eps |.|^2, (3.18) and (3.19)
lost it: as E is defined, D = (rho + 1) sum K^T K + eps 1 and
d = sum K^T (rho dI + dI_0) + eps (M'_t-1 - M_t).
No point shares an entry of D with another, so it is solved in blocks of three.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.head.patches import PATCH, sample_grid
from posetrack_cli.head.refinement.evidence import (
    Evidence,
    Room,
    gather,
    make_evidence,
    make_room,
    project_point,
)
from posetrack_cli.head.refinement.joint import invert
from posetrack_cli.head.refinement.recalculation import transform
from posetrack_cli.head.refinement.scene import Scene


class Printed(NamedTuple):
    """The two constants, which belong to 8-bit intensities and mm."""

    rho: float
    epsilon: float


@kernel
def recalculate_as_printed(
    scene: Scene,
    rotation: FloatArray,
    position: FloatArray,
    shape: FloatArray,
    printed: Printed,
    iterations: int,
    points: FloatArray,
    correlations: FloatArray,
    pixels: FloatArray,
) -> None:
    """Descend from points (K, 3), which are written over; arguments as of ``recalculate_points``."""
    cameras = len(scene.images.sizes)
    evidence, room = make_evidence(cameras), make_room(cameras)
    inverse, X, d = np.empty((3, 3)), np.empty(3), np.empty(3)
    for k in range(len(points)):
        for _ in range(iterations):
            transform(rotation, points[k], position, X)
            _gather_raw(scene, k, X, printed.rho, room, evidence)
            transform(rotation, points[k] - shape[k], np.zeros(3), d)
            invert(evidence.hessian, printed.epsilon, inverse)
            for i in range(3):
                for j in range(3):
                    step = 0.0
                    for m in range(3):
                        step -= inverse[j, m] * (evidence.gradient[m] + printed.epsilon * d[m])
                    points[k, i] += rotation[j, i] * step
        transform(rotation, points[k], position, X)
        gather(scene, k, X, room, evidence)
        correlations[:, k] = evidence.correlations
        pixels[:, k] = evidence.pixels


@kernel
def _gather_raw(scene: Scene, k: int, X: FloatArray, rho: float, room: Room, out: Evidence) -> None:
    """Write half the derivatives of the regions' part of E at X (3,), in camera axes."""
    images, upright = scene.images, np.eye(2)
    out.hessian[:] = 0.0
    out.gradient[:] = 0.0
    for c in range(len(images.sizes)):
        if not project_point(scene.optics, c, k, X, out.pixels[c], room.jacobians[c]):
            continue
        u, v = out.pixels[c, 0] - images.corners[c, 0], out.pixels[c, 1] - images.corners[c, 1]
        width, height = images.sizes[c, 0], images.sizes[c, 1]
        if not sample_grid(images.windows[c], width, height, u, v, upright, room.grid):
            continue
        for s in range(2):
            if not np.isnan(scene.raw[s, c, k, 0, 0]):
                _add_region(room.grid, scene.raw[s, c, k], room.jacobians[c], 1.0 if s == 0 else rho, out)


@kernel
def _add_region(grid: FloatArray, target: FloatArray, J: FloatArray, weight: float, out: Evidence) -> None:
    """Add weight |I - target|^2 / 2 over a region's pixels: K = (dI/dm) J is one row for each."""
    row = np.empty(3)
    for j in range(1, PATCH + 1):
        for i in range(1, PATCH + 1):
            along = 0.5 * (grid[j, i + 1] - grid[j, i - 1])
            down = 0.5 * (grid[j + 1, i] - grid[j - 1, i])
            difference = grid[j, i] - target[j, i]
            for n in range(3):
                row[n] = along * J[0, n] + down * J[1, n]
            for n in range(3):
                out.gradient[n] += weight * row[n] * difference
                for m in range(3):
                    out.hessian[n, m] += weight * row[n] * row[m]
