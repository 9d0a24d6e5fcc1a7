"""Poses of a head and the places of skin in it, adjusted to where the skin was found.

    E = sum_o rho(|f (r_o - pi(R_i X_j + t_i))| / sigma)
        + 1/2 sum_i |pose_i (-) told_i|^2 / S_p  +  1/2 sum_j |X_j - X0_j|^2 / S_x

pi(x, y, z) = (x, y) / z, r_o the ray of an observation of point j in view i, rho Cauchy's. Points are
eliminated (Schur complement), as in any bundle adjustment (Triggs et al. 2000).
"""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.head.face.pose import POSE_SIZE, HeadPose
from posetrack_cli.head.skin.equations import (
    Equations,
    Observations,
    add_points,
    add_to_pose,
    make_equations,
    move_points,
)

POSE_SD = np.array([6.0, 6.0, 25.0, *np.radians([6.0, 6.0, 6.0])])
"""(6,) mm and rad about the poses that feature points tell: wide, as those may slide."""
POINT_SD = np.array([2.0, 2.0, 8.0])
"""(3,) mm about the surface."""
CONVERGED = 1e-4
"""A pose is found where a step changes it by no more, in ``POSE_SD``."""


def observations(views: IntArray, points: IntArray, rays: FloatArray, count: int) -> Observations:
    """Return observations in the order of ``count`` points; those of one point stay in their order.

    Args:
        views, points: (N,) indices of each.
        rays: (N, 2) of each.
        count: M, of points.
    """
    order = np.argsort(points, kind="stable")
    first = np.searchsorted(points[order], np.arange(count + 1))
    return Observations(views[order], first, rays[order])


def adjust_pose(
    rays: FloatArray, points: FloatArray, start: HeadPose, told: HeadPose, f: FloatArray, steps: int
) -> HeadPose:
    """Return the pose from which points (N, 3), mm in the head's frame, lie on rays (N, 2).

    Args:
        rays, points: of observations.
        start: of the descent.
        told: by feature points.
        f: (2,) focal lengths, pixels.
        steps: of Gauss and Newton, at most.
    """
    pose, precisions = start, POSE_SD**-2
    for _ in range(steps):
        matrix, vector = np.diag(precisions), precisions * pose.difference(told)
        add_to_pose(rays, points, pose.rotation, pose.position, f, matrix, vector)
        tangent = np.asarray(np.linalg.solve(matrix, vector), dtype=np.float64)
        pose = pose.moved(tangent)
        if np.all(np.abs(tangent) < CONVERGED * POSE_SD):
            break
    return pose


def adjust_skin(
    observed: Observations, told: HeadPose, surface: FloatArray, f: FloatArray, steps: int
) -> tuple[HeadPose, FloatArray]:
    """Return the poses (n) of all views and the places (M, 3) of all points.

    Args:
        observed: in the views.
        told: (n) poses of the views by their feature points, where the descent begins.
        surface: (M, 3) X0, mm in the head's frame.
        f: (2,) focal lengths, pixels.
        steps: of Gauss and Newton.
    """
    poses, points = told, surface
    equations, moves = make_equations(len(told.position), observed), np.empty_like(surface)
    for _ in range(steps):
        turns = _solve(observed, poses, points, told, surface, f, equations)
        move_points(observed, equations, turns, moves)
        poses, points = poses.moved(turns), points + moves
    return poses, points


def _solve(
    observed: Observations,
    poses: HeadPose,
    points: FloatArray,
    told: HeadPose,
    surface: FloatArray,
    f: FloatArray,
    equations: Equations,
) -> FloatArray:
    """Write the normal equations, and return the tangent vectors (n, 6) of the views."""
    precisions = np.tile(POSE_SD**-2, len(poses.position))
    equations.matrix[:] = 0.0
    np.fill_diagonal(equations.matrix, precisions)
    equations.vector[:] = precisions * poses.difference(told).ravel()
    equations.inverses[:] = np.diag(POINT_SD**-2)
    equations.pulls[:] = (surface - points) / POINT_SD**2
    add_points(observed, poses.rotation, poses.position, points, f, equations)
    turns = np.linalg.solve(equations.matrix, equations.vector)
    return np.asarray(turns, dtype=np.float64).reshape(-1, POSE_SIZE)
