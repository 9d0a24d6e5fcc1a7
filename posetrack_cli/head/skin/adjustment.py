"""Poses of a head and the places of skin in it, adjusted to where the skin was found.

    E = sum_o rho(|f (r_o - pi(R_i X_j + t_i))| / sigma)
        + 1/2 sum_i |pose_i (-) told_i|^2 / S_p  +  1/2 sum_j |X_j - X0_j|^2 / S_x

pi(x, y, z) = (x, y) / z, r_o the ray of an observation of point j in view i, rho Cauchy's. Points are
eliminated (Schur complement), as in any bundle adjustment (Triggs et al. 2000).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.geometry.rotations import cross_matrices
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose

NOISE_PX = 0.7
"""sigma, of a place that was found."""
TAIL = 2.0
"""Cauchy's: at so many deviations a place counts half."""
POSE_SD = np.array([6.0, 6.0, 25.0, *np.radians([6.0, 6.0, 6.0])])
"""(6,) mm and rad about the poses that feature points tell: wide, as those may slide."""
POINT_SD = np.array([2.0, 2.0, 8.0])
"""(3,) mm about the surface."""


class Observations(NamedTuple):
    """Where points were found.

    Attributes:
        views: (N,) index of the view.
        points: (N,) index of the point.
        rays: (N, 2) without the lens, z = 1.
    """

    views: IntArray
    points: IntArray
    rays: FloatArray


class Linearised(NamedTuple):
    """Observations about poses and points.

    Attributes:
        residuals: (N, 2) pixels.
        weights: (N,) 1 / pixel^2.
        by_pose: (N, 2, 6) derivatives of what is seen.
        by_point: (N, 2, 3).
    """

    residuals: FloatArray
    weights: FloatArray
    by_pose: FloatArray
    by_point: FloatArray


def linearise(
    rays: FloatArray, rotations: FloatArray, arms: FloatArray, positions: FloatArray, f: FloatArray
) -> Linearised:
    """Return observations about where they are expected.

    Args:
        rays: (N, 2).
        rotations: (N, 3, 3) R of each observation's view.
        arms: (N, 3) R X.
        positions: (N, 3) t.
        f: (2,) focal lengths, pixels.
    """
    seen = arms + positions
    depth = np.maximum(seen[:, 2], 1.0)
    x, y = seen[:, 0] / depth, seen[:, 1] / depth
    residuals = (rays - np.column_stack([x, y])) * f
    by_place = np.zeros((len(rays), 2, 3))
    by_place[:, 0, 0], by_place[:, 0, 2] = f[0] / depth, -f[0] * x / depth
    by_place[:, 1, 1], by_place[:, 1, 2] = f[1] / depth, -f[1] * y / depth
    squared = np.einsum("ni,ni->n", residuals, residuals) / NOISE_PX**2
    weights = 1.0 / (1.0 + squared / TAIL**2) / NOISE_PX**2
    by_pose = np.concatenate([by_place, -by_place @ cross_matrices(arms)], axis=2)
    return Linearised(residuals, weights, by_pose, by_place @ rotations)


def adjust_pose(
    rays: FloatArray, points: FloatArray, start: HeadPose, told: HeadPose, f: FloatArray, steps: int
) -> HeadPose:
    """Return the pose from which points (N, 3), mm in the head's frame, lie on rays (N, 2).

    Args:
        rays, points: of observations.
        start: of the descent.
        told: by feature points.
        f: (2,) focal lengths, pixels.
        steps: of Gauss and Newton.
    """
    pose, precision = start, np.diag(POSE_SD**-2)
    for _ in range(steps):
        R = pose.rotation
        arms = points @ R.T
        seen = linearise(rays, R[None], arms, pose.position, f)
        J, w = seen.by_pose, seen.weights
        matrix = np.einsum("n,nki,nkj->ij", w, J, J) + precision
        vector = np.einsum("n,nki,nk->i", w, J, seen.residuals) + precision @ pose.difference(told)
        pose = pose.moved(np.linalg.solve(matrix, vector))
    return pose


def adjust_skin(
    observed: Observations, told: list[HeadPose], surface: FloatArray, f: FloatArray, steps: int
) -> tuple[list[HeadPose], FloatArray]:
    """Return the poses of all views and the places (M, 3) of all points.

    Args:
        observed: in the views.
        told: pose of each view by its feature points, where the descent begins.
        surface: (M, 3) X0, mm in the head's frame.
        f: (2,) focal lengths, pixels.
        steps: of Gauss and Newton.
    """
    poses, points = list(told), surface
    for _ in range(steps):
        turns, moves = _step(observed, poses, points, told, surface, f)
        poses = [pose.moved(turn) for pose, turn in zip(poses, turns, strict=True)]
        points = points + moves
    return poses, points


def _step(
    observed: Observations,
    poses: list[HeadPose],
    points: FloatArray,
    told: list[HeadPose],
    surface: FloatArray,
    f: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return tangent vectors (n, 6) of poses and shifts (M, 3) of points: the normal equations' solution."""
    i, j, n, m = observed.views, observed.points, len(poses), len(points)
    R = np.array([pose.rotation for pose in poses])
    t = np.array([pose.position for pose in poses])
    seen = linearise(observed.rays, R[i], np.einsum("nij,nj->ni", R[i], points[j]), t[i], f)
    weighted = seen.weights[:, None, None] * seen.by_pose
    A = _summed(i, n, np.einsum("nki,nkj->nij", weighted, seen.by_pose)) + np.diag(POSE_SD**-2)
    differences = np.array([pose.difference(one) for pose, one in zip(poses, told, strict=True)])
    b = _summed(i, n, np.einsum("nki,nk->ni", weighted, seen.residuals)) + differences / POSE_SD**2
    of_point = seen.weights[:, None, None] * seen.by_point
    V = _summed(j, m, np.einsum("nki,nkj->nij", of_point, seen.by_point)) + np.diag(POINT_SD**-2)
    c = _summed(j, m, np.einsum("nki,nk->ni", of_point, seen.residuals)) + (surface - points) / POINT_SD**2
    W = _blocks(np.einsum("nki,nkj->nij", weighted, seen.by_point), i, j, n, m)
    inverse = _blocks(np.asarray(np.linalg.inv(V), dtype=np.float64), np.arange(m), np.arange(m), m, m)
    along = W @ inverse
    schur = -(along @ W.T).toarray()
    diagonal = POSE_SIZE * np.arange(n)[:, None, None] + np.arange(POSE_SIZE)
    schur[diagonal.transpose(0, 2, 1), diagonal] += A
    turns = np.linalg.solve(schur, b.ravel() - along @ c.ravel())
    moves = inverse @ (c.ravel() - W.T @ turns)
    return turns.reshape(n, POSE_SIZE), moves.reshape(m, 3)


def _summed(rows: IntArray, count: int, values: FloatArray) -> FloatArray:
    """Return (count, ...) the sums of values (N, ...) of each row (N,)."""
    ones = sparse.csr_array((np.ones(len(rows)), (rows, np.arange(len(rows)))), shape=(count, len(rows)))
    sums: FloatArray = (ones @ values.reshape(len(rows), -1)).reshape(count, *values.shape[1:])
    return sums


def _blocks(values: FloatArray, rows: IntArray, columns: IntArray, n: int, m: int) -> sparse.csr_array:
    """Return the sparse matrix (n a, m b) of blocks (N, a, b); blocks at one place are added."""
    a, b = values.shape[1:]
    at_row = np.broadcast_to(a * rows[:, None, None] + np.arange(a)[:, None], values.shape)
    at_column = np.broadcast_to(b * columns[:, None, None] + np.arange(b), values.shape)
    where = at_row.ravel(), at_column.ravel()
    return sparse.csr_array((values.ravel(), where), shape=(n * a, m * b))
