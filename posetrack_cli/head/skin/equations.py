"""Joint adjustment of poses and skin points."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.compiled import inlined, kernel
from posetrack_cli.geometry.least_squares import cauchy, invert_symmetric
from posetrack_cli.geometry.rotations import multiply, quaternions_from_matrices
from posetrack_cli.head.face.points import POSE_SIZE, HeadPose

# Normal equations of poses and points; compiled. A view is an image of one camera, in that camera's axes.
#
# With A and V the diagonal blocks of views and points, W those between them, b and c the right-hand sides:
#
#     (A - W V^-1 W^T) x = b - W V^-1 c,    y = V^-1 (c - W^T x)


POSE, PLACE = 6, 3
NOISE_PX = 0.7
"""sigma, of a matched place."""
TAIL = 2.0
"""Scale of Cauchy's function, in standard deviations: the residual with a weight of one half."""
NEAREST_MM = 1.0
"""Minimum depth of a point."""


class Observations(NamedTuple):
    """Matched places, sorted by point.

    Attributes:
        views: (N,) index of the view.
        first: (M + 1,) observations of point j are those from first[j] up to first[j + 1].
        rays: (N, 2) undistorted, z = 1.
    """

    views: IntArray
    first: IntArray
    rays: FloatArray


class Equations(NamedTuple):
    """Equations of the views with the points eliminated, and data for the back substitution.

    Attributes:
        matrix: (6 n, 6 n) A - W V^-1 W^T.
        vector: (6 n,) b - W V^-1 c.
        inverses: (M, 3, 3) V^-1.
        pulls: (M, 3) c.
        cross: (N, 6, 3) W.
    """

    matrix: FloatArray
    vector: FloatArray
    inverses: FloatArray
    pulls: FloatArray
    cross: FloatArray


def make_equations(views: int, observed: Observations) -> Equations:
    """Allocate the equations."""
    points = len(observed.first) - 1
    return Equations(
        np.empty((POSE * views, POSE * views)),
        np.empty(POSE * views),
        np.empty((points, PLACE, PLACE)),
        np.empty((points, PLACE)),
        np.empty((len(observed.views), POSE, PLACE)),
    )


@kernel
def linearise(
    ray: FloatArray,
    R: FloatArray,
    t: FloatArray,
    point: FloatArray,
    f: FloatArray,
    residual: FloatArray,
    J: FloatArray,
) -> float:
    """Linearise an observation, and return its weight, 1 / pixel^2.

    Args:
        ray: (2,).
        R, t: (3, 3), (3,) of its view.
        point: (3,) X.
        f: (2,) focal lengths, pixels.
        residual: (2,) out, pixels.
        J: (2, 9) out, derivative of the projection by the view's tangent vector, then by X: G (1, -[R X]_x,
            R).
    """
    a = R[0, 0] * point[0] + R[0, 1] * point[1] + R[0, 2] * point[2]
    b = R[1, 0] * point[0] + R[1, 1] * point[1] + R[1, 2] * point[2]
    c = R[2, 0] * point[0] + R[2, 1] * point[1] + R[2, 2] * point[2]
    z = max(c + t[2], NEAREST_MM)
    squared = 0.0
    for r in range(2):
        seen = ((a if r == 0 else b) + t[r]) / z
        residual[r] = (ray[r] - seen) * f[r]
        squared += residual[r] * residual[r]
        g, h = f[r] / z, -f[r] * seen / z
        x, y = (g, 0.0) if r == 0 else (0.0, g)
        J[r, 0], J[r, 1], J[r, 2] = x, y, h
        J[r, 3], J[r, 4], J[r, 5] = b * h - c * y, c * x - a * h, a * y - b * x
        for i in range(PLACE):
            J[r, POSE + i] = x * R[0, i] + y * R[1, i] + h * R[2, i]
    return float(cauchy(squared / (NOISE_PX * TAIL) ** 2) / NOISE_PX**2)


@kernel
def add_to_pose(
    rays: FloatArray,
    points: FloatArray,
    R: FloatArray,
    t: FloatArray,
    f: FloatArray,
    matrix: FloatArray,
    vector: FloatArray,
) -> None:
    """Add observations (N, 2) of points (N, 3) to the equations (6, 6), (6,) of one pose."""
    residual, J = np.empty(2), np.empty((2, POSE + PLACE))
    for o in range(len(rays)):
        weight = linearise(rays[o], R, t, points[o], f, residual, J)
        _add_pose(weight, residual, J, matrix, vector)


@inlined
def _add_pose(
    weight: float, residual: FloatArray, J: FloatArray, matrix: FloatArray, vector: FloatArray
) -> None:
    for r in range(2):
        for i in range(POSE):
            along = weight * J[r, i]
            vector[i] += along * residual[r]
            for j in range(POSE):
                matrix[i, j] += along * J[r, j]


@kernel
def add_points(
    observed: Observations,
    rotations: FloatArray,
    positions: FloatArray,
    points: FloatArray,
    f: FloatArray,
    equations: Equations,
) -> None:
    """Add all observations to the equations, which contain the priors of points, and eliminate the points.

    Args:
        observed: in the views.
        rotations, positions: (n, 3, 3), (n, 3) of the views.
        points: (M, 3).
        f: (2,) focal lengths, pixels.
        equations: with the priors of the points in ``inverses`` (V, not yet inverted) and ``pulls``.
    """
    residual, J, V = np.empty(2), np.empty((2, POSE + PLACE)), np.empty((PLACE, PLACE))
    for j in range(len(points)):
        V[:] = equations.inverses[j]
        for o in range(observed.first[j], observed.first[j + 1]):
            view = observed.views[o]
            weight = linearise(observed.rays[o], rotations[view], positions[view], points[j], f, residual, J)
            own = slice(POSE * view, POSE * (view + 1))
            _add_pose(weight, residual, J, equations.matrix[own, own], equations.vector[own])
            _add_place(weight, residual, J, V, equations.pulls[j], equations.cross[o])
        invert_symmetric(V, 0.0, equations.inverses[j])
        _eliminate(observed, j, equations)


@inlined
def _add_place(
    weight: float, residual: FloatArray, J: FloatArray, V: FloatArray, pull: FloatArray, cross: FloatArray
) -> None:
    """Add an observation to its point's V and c, and write its W."""
    for i in range(PLACE):
        for r in range(2):
            along = weight * J[r, POSE + i]
            pull[i] += along * residual[r]
            for j in range(PLACE):
                V[i, j] += along * J[r, POSE + j]
        for a in range(POSE):
            cross[a, i] = weight * (J[0, a] * J[0, POSE + i] + J[1, a] * J[1, POSE + i])


@kernel
def _eliminate(observed: Observations, j: int, equations: Equations) -> None:
    """Subtract W V^-1 W^T and W V^-1 c of a point."""
    inverse, pull, along = equations.inverses[j], equations.pulls[j], np.empty((POSE, PLACE))
    first, last = observed.first[j], observed.first[j + 1]
    for o in range(first, last):
        row = POSE * observed.views[o]
        for a in range(POSE):
            for i in range(PLACE):
                along[a, i] = 0.0
                for m in range(PLACE):
                    along[a, i] += equations.cross[o, a, m] * inverse[m, i]
                equations.vector[row + a] -= along[a, i] * pull[i]
        for other in range(first, last):
            column = POSE * observed.views[other]
            for a in range(POSE):
                for b in range(POSE):
                    for i in range(PLACE):
                        equations.matrix[row + a, column + b] -= along[a, i] * equations.cross[other, b, i]


@kernel
def move_points(
    observed: Observations, equations: Equations, tangents: FloatArray, moves: FloatArray
) -> None:
    """Write the steps (M, 3) of points y for tangent vectors (n, 6) of views x."""
    for j in range(len(moves)):
        for i in range(PLACE):
            moves[j, i] = 0.0
        for m in range(PLACE):
            left = equations.pulls[j, m]
            for o in range(observed.first[j], observed.first[j + 1]):
                for a in range(POSE):
                    left -= equations.cross[o, a, m] * tangents[observed.views[o], a]
            for i in range(PLACE):
                moves[j, i] += equations.inverses[j, i, m] * left


# Bundle adjustment of head poses and skin points (Triggs et al. 2000).
#
#     E = sum_o rho(|f (r_o - pi(R_i X_j + t_i))| / sigma)
#         + 1/2 sum_i |pose_i (-) prior_i|^2 / S_p  +  1/2 sum_j |X_j - X0_j|^2 / S_x
#
# pi(x, y, z) = (x, y) / z, r_o the ray of an observation of point j in view i, rho Cauchy's function. Points
# are eliminated (Schur complement). With several cameras, the views of a frame have the same pose in the axes
# of the reference camera: R_c R_i and R_c t_i + t_c in those of camera c.

ONLY = np.eye(3, 4)[None]
"""camera_T_reference (1, 3, 4) of a single camera."""
POSE_SD = np.array([6.0, 6.0, 25.0, *np.radians([6.0, 6.0, 6.0])])
"""(6,) mm and rad about the poses of the feature points: wide, as these may slide."""
MEASURED_SD = np.array([0.1, 0.1, 0.2, *np.radians([0.3, 0.3, 0.3])])
"""(6,) the same with several cameras, which measure the points. Matches of neighbouring views are biased
towards no motion, which adds up over wide turns."""
POINT_SD = np.array([2.0, 2.0, 8.0])
"""(3,) mm about the surface."""
CONVERGED = 1e-4
"""Largest change of a pose in the last step, in ``POSE_SD``."""


def observations(views: IntArray, points: IntArray, rays: FloatArray, count: int) -> Observations:
    """Sort observations by point, stably.

    Args:
        views, points: (N,) indices of each.
        rays: (N, 2) of each.
        count: M, number of points.
    """
    order = np.argsort(points, kind="stable")
    first = np.searchsorted(points[order], np.arange(count + 1))
    return Observations(views[order], first, rays[order])


def in_cameras(poses: HeadPose, transforms: FloatArray) -> HeadPose:
    """Return poses (n) in the axes of each of C cameras, (n C), those of a frame together.

    Args:
        poses: in the axes of the reference camera.
        transforms: (C, 3, 4) camera_T_reference, mm.
    """
    if len(transforms) == 1:  # the reference itself
        return poses
    rotations = transforms[:, :, :3]
    positions = np.einsum("cij,nj->nci", rotations, poses.position) + transforms[:, :, 3]
    turned = multiply(_quaternions(rotations.tobytes()), poses.quaternion[:, None])
    return HeadPose(positions.reshape(-1, 3), turned.reshape(-1, 4))


@lru_cache(maxsize=8)
def _quaternions(rotations: bytes) -> FloatArray:
    """Return the quaternions (C, 4) of the cameras' rotations (C, 3, 3), needed several times per frame."""
    return quaternions_from_matrices(np.frombuffer(rotations).reshape(-1, 3, 3))


def _tangent_maps(transforms: FloatArray) -> FloatArray:
    """Return (C, 6, 6), from tangent vectors of a pose to those of the same pose in each camera's axes."""
    maps = np.zeros((len(transforms), POSE, POSE))
    maps[:, :3, :3] = maps[:, 3:, 3:] = transforms[:, :, :3]
    return maps


def adjust_pose(
    seen: Sequence[tuple[FloatArray, FloatArray]],
    start: HeadPose,
    prior: HeadPose,
    f: FloatArray,
    steps: int,
    transforms: FloatArray = ONLY,
    pose_sd: FloatArray = POSE_SD,
) -> HeadPose:
    """Fit the pose in which points lie on rays.

    Args:
        seen: rays (N, 2) and points (N, 3), mm in the head's frame, observed by each camera.
        start: of the optimisation.
        prior: pose of the feature points.
        f: (2,) focal lengths, pixels.
        steps: maximum number of Gauss-Newton steps.
        transforms: (C, 3, 4) camera_T_reference, mm.
        pose_sd: (6,) standard deviations about the prior.
    """
    pose, precisions = start, pose_sd**-2
    maps = _tangent_maps(transforms)
    for _ in range(steps):
        matrix, vector = np.diag(precisions), precisions * pose.difference(prior)
        own = in_cameras(HeadPose(pose.position[None], pose.quaternion[None]), transforms)
        for c, (rays, points) in enumerate(seen):
            of_camera, pull = np.zeros((POSE, POSE)), np.zeros(POSE)
            add_to_pose(rays, points, own.rotation[c], own.position[c], f, of_camera, pull)
            matrix += maps[c].T @ of_camera @ maps[c]
            vector += maps[c].T @ pull
        tangent = np.asarray(np.linalg.solve(matrix, vector), dtype=np.float64)
        pose = pose.moved(tangent)
        if (np.abs(tangent) < CONVERGED * np.minimum(pose_sd, POSE_SD)).all():
            break
    return pose


class SkinPrior(NamedTuple):
    """Expected poses and points.

    Attributes:
        poses: (n) of the views, from their feature points.
        surface: (M, 3) X0, mm in the head's frame.
        pose_sd, point_sd: (6,) and (3,) standard deviations about them.
    """

    poses: HeadPose
    surface: FloatArray
    pose_sd: FloatArray = POSE_SD
    point_sd: FloatArray = POINT_SD


def adjust_skin(
    observed: Observations,
    prior: SkinPrior,
    f: FloatArray,
    steps: int,
    start: tuple[HeadPose, FloatArray] | None = None,
    transforms: FloatArray = ONLY,
) -> tuple[HeadPose, FloatArray]:
    """Adjust the poses (n) of all frames and the places (M, 3) of all points.

    Args:
        observed: in the views, C of each frame.
        prior: of poses and points, by default also the start.
        f: (2,) focal lengths, pixels.
        steps: number of Gauss-Newton steps.
        start: other poses and points to start from.
        transforms: (C, 3, 4) camera_T_reference, mm.
    """
    poses, points = start or (prior.poses, prior.surface)
    views, maps = len(transforms) * len(poses.position), _tangent_maps(transforms)
    equations, moves = make_equations(views, observed), np.empty_like(points)
    for _ in range(steps):
        tangents = _solve(observed, poses, points, prior, f, equations, transforms)
        of_views = np.einsum("cij,nj->nci", maps, tangents).reshape(views, POSE)
        move_points(observed, equations, of_views, moves)
        poses, points = poses.moved(tangents), points + moves
    return poses, points


def skin_cost(
    observed: Observations, poses: HeadPose, points: FloatArray, prior: SkinPrior, f: FloatArray
) -> float:
    """Return E of adjusted poses and points of one camera; see ``adjust_skin``."""
    owners = np.repeat(np.arange(len(points)), np.diff(observed.first))
    seen = np.einsum("nij,nj->ni", poses.rotation[observed.views], points[owners])
    seen += poses.position[observed.views]
    depths = np.maximum(seen[:, 2:], NEAREST_MM)
    squared = np.sum(np.square((observed.rays - seen[:, :2] / depths) * f), axis=1)
    scale = (TAIL * NOISE_PX) ** 2
    total = 0.5 * TAIL**2 * np.log1p(squared / scale).sum()
    total += 0.5 * np.sum(np.square(poses.difference(prior.poses) / prior.pose_sd))
    return float(total + 0.5 * np.sum(np.square((points - prior.surface) / prior.point_sd)))


def _solve(
    observed: Observations,
    poses: HeadPose,
    points: FloatArray,
    prior: SkinPrior,
    f: FloatArray,
    equations: Equations,
    transforms: FloatArray = ONLY,
) -> FloatArray:
    """Build and solve the normal equations; return the tangent vectors (n, 6) of the frames."""
    matrix, vector = equations.matrix, equations.vector
    matrix[:] = vector[:] = 0.0
    equations.inverses[:] = np.diag(prior.point_sd**-2)
    equations.pulls[:] = (prior.surface - points) / prior.point_sd**2
    views, frames, cameras = in_cameras(poses, transforms), len(poses.position), len(transforms)
    add_points(observed, views.rotation, views.position, points, f, equations)
    if cameras > 1:
        maps, blocks = _tangent_maps(transforms), matrix.reshape(2 * (frames, cameras, POSE))
        matrix = np.einsum("cai,ncamdb,dbj->nimj", maps, blocks, maps, optimize=True).reshape(
            POSE * frames, -1
        )
        vector = np.einsum("cai,nca->ni", maps, vector.reshape(frames, cameras, POSE)).ravel()
    precisions = np.tile(prior.pose_sd**-2, frames)
    pull = vector + precisions * poses.difference(prior.poses).ravel()
    tangents = np.linalg.solve(matrix + np.diag(precisions), pull)
    return np.asarray(tangents, dtype=np.float64).reshape(-1, POSE_SIZE)
