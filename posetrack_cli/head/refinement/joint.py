"""Joint Gauss-Newton over pose, deformation and a residual for each point **[ours]**; compiled.

    X_k = R (Mbar_k + V_k a + delta_k) + t
    E = sum_k E_k(X_k)  +  1/2 sum_b (a_b / mu_b)^2  +  sum_k (nu + 3)/2 log(1 + |delta_k|^2 / (nu s_k^2))
        + 1/2 |pose (-) predicted|^2 in units of a wide prior

E_k is the patch term (``evidence``). delta is Student-t, so that points far from the model cost little more
than near ones. Every step reweights it, l_k = (nu + 3) / (nu s_k^2 + |delta_k|^2), and eliminates it (Schur
complement), which leaves 6 + B unknowns for any K.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.compiled import kernel
from posetrack_cli.geometry.kernels import rotate_in_place
from posetrack_cli.geometry.least_squares import invert_symmetric, solve, student_t
from posetrack_cli.head.refinement.evidence import (
    Evidence,
    Scene,
    gather_evidence,
    make_evidence,
    make_workspace,
)

POSE = 6
CONVERGED_PX = 0.01
"""Largest motion of a point in the last step: a tenth of the patches' accuracy."""


class Face(NamedTuple):
    """The shape model.

    Attributes:
        mean: (K, 3) mm.
        basis: (K, 3, B).
        precisions: (B,) 1 / mu^2, 1 / mm^2.
    """

    mean: FloatArray
    basis: FloatArray
    precisions: FloatArray


class Prior(NamedTuple):
    """Prior of residuals and pose.

    Attributes:
        scales: (K,) s_k, mm.
        freedom: nu.
        pose: (6,) precisions about the predicted pose, 1 / mm^2, then 1 / rad^2.
    """

    scales: FloatArray
    freedom: float
    pose: FloatArray


class FaceUnknowns(NamedTuple):
    """Unknowns, modified in place by ``descend``.

    Attributes:
        rotation: (3, 3) R.
        position: (3,) t, mm.
        coefficients: (B,) a, mm.
        residuals: (K, 3) delta in the head's frame, mm.
        moved: (6,) total displacement of the pose, a tangent vector summed over the steps.
        correlations: (C, K).
    """

    rotation: FloatArray
    position: FloatArray
    coefficients: FloatArray
    residuals: FloatArray
    moved: FloatArray
    correlations: FloatArray


@kernel
def descend(scene: Scene, face: Face, prior: Prior, iterations: int, state: FaceUnknowns) -> None:
    """Iterate Gauss-Newton steps to convergence, then compute the correlations at the result."""
    count, size = len(face.mean), POSE + len(face.precisions)
    cameras = len(scene.images.sizes)
    evidence, work = make_evidence(cameras), make_workspace(cameras)
    # allocated once and reused in every step
    matrix, vector, step, e = np.empty((size, size)), np.empty(size), np.empty(size), np.empty(3)
    arm, hessians, gradients = np.empty(3), np.empty((count, 3, 3)), np.empty((count, 3))
    rows, residuals, weights = np.empty((count, 3, size)), np.empty((count, 3)), np.empty(count)
    for _ in range(iterations):
        start_equations(face, prior, state, matrix, vector)
        for k in range(count):
            point_in_camera(face, state, k, arm)
            gather_evidence(scene, k, arm + state.position, work, evidence)
            for i in range(3):  # element by element: slices add a second to the compile time
                gradients[k, i] = evidence.gradient[i]
                for j in range(3):
                    hessians[k, i, j] = evidence.hessian[i, j]
            squared = _residual(state, k, residuals[k])
            weights[k] = student_t(squared, 3.0, prior.freedom, prior.scales[k])
            # the residual is eliminated here and recovered below, once the common step is known
            jacobian(face, state, k, arm, rows[k])
            eliminate(hessians[k], gradients[k], weights[k], residuals[k], rows[k], matrix, vector)
        solve(matrix, -vector, step)
        farthest = 0.0
        for k in range(count):
            pull, moved = gradients[k] + weights[k] * residuals[k], np.zeros(3)
            _add_along(hessians[k], rows[k], step, pull, moved)
            move_point(hessians[k], weights[k], pull, state.rotation, state.residuals[k], e)
            squared = (moved[0] + e[0]) ** 2 + (moved[1] + e[1]) ** 2 + (moved[2] + e[2]) ** 2
            farthest = max(farthest, np.sqrt(squared))
        apply_step(state, step)
        if farthest < CONVERGED_PX * state.position[2] / scene.optics.intrinsics[0, 0]:
            break
    write_correlations(scene, face, state, arm, evidence)


@kernel
def write_correlations(
    scene: Scene, face: Face, state: FaceUnknowns, arm: FloatArray, evidence: Evidence
) -> None:
    """Write the correlations at the current unknowns."""
    work = make_workspace(len(scene.images.sizes))
    for k in range(len(face.mean)):
        point_in_camera(face, state, k, arm)
        gather_evidence(scene, k, arm + state.position, work, evidence)
        for c in range(len(evidence.correlations)):
            state.correlations[c, k] = evidence.correlations[c]


@kernel
def point_in_camera(face: Face, state: FaceUnknowns, k: int, arm: FloatArray) -> None:
    """Write R M_k (3,), the point relative to the head's origin in camera axes."""
    local = np.empty(3)
    for i in range(3):
        local[i] = face.mean[k, i] + state.residuals[k, i]
        for b in range(len(face.precisions)):
            local[i] += face.basis[k, i, b] * state.coefficients[b]
    for i in range(3):
        arm[i] = 0.0
        for j in range(3):
            arm[i] += state.rotation[i, j] * local[j]


@kernel
def start_equations(
    face: Face, prior: Prior, state: FaceUnknowns, matrix: FloatArray, vector: FloatArray
) -> None:
    """Initialise the normal equations with the priors of pose and deformation."""
    matrix[:] = 0.0
    for i in range(POSE):
        matrix[i, i] = prior.pose[i]
        vector[i] = prior.pose[i] * state.moved[i]
    for b in range(len(face.precisions)):
        matrix[POSE + b, POSE + b] = face.precisions[b]
        vector[POSE + b] = face.precisions[b] * state.coefficients[b]


@kernel
def jacobian(face: Face, state: FaceUnknowns, k: int, arm: FloatArray, T: FloatArray) -> None:
    """Write dX_k / d (translation, rotation, a), (3, 6 + B): (1, -[R M]_x, R V)."""
    T[:] = 0.0
    for i in range(3):
        T[i, i] = 1.0
        for b in range(len(face.precisions)):
            for j in range(3):
                T[i, POSE + b] += state.rotation[i, j] * face.basis[k, j, b]
    T[0, 4], T[0, 5] = arm[2], -arm[1]
    T[1, 3], T[1, 5] = -arm[2], arm[0]
    T[2, 3], T[2, 4] = arm[1], -arm[0]


@kernel
def _residual(state: FaceUnknowns, k: int, out: FloatArray) -> float:
    """Write R delta_k, camera axes; return its squared length."""
    squared = 0.0
    for i in range(3):
        out[i] = 0.0
        for j in range(3):
            out[i] += state.rotation[i, j] * state.residuals[k, j]
        squared += state.residuals[k, i] ** 2
    return squared


@kernel
def eliminate(
    H: FloatArray,
    g: FloatArray,
    weight: float,
    d: FloatArray,
    T: FloatArray,
    matrix: FloatArray,
    vector: FloatArray,
) -> None:
    """Add a point's contribution to pose and deformation, with its residual eliminated.

    (H + l) e + H T x = -(g + l d), with d = R delta, gives T^T S T x = -T^T s, S = l (H + l)^-1 H and
    s = l (H + l)^-1 (g - H d).
    """
    inverse, s, S = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    invert_symmetric(H, weight, inverse)
    for i in range(3):
        s[i] = 0.0
        for j in range(3):
            s[i] += weight * inverse[i, j] * (g[j] - H[j, 0] * d[0] - H[j, 1] * d[1] - H[j, 2] * d[2])
            S[i, j] = 0.0
            for m in range(3):
                S[i, j] += weight * inverse[i, m] * H[m, j]
    for a in range(len(vector)):
        for i in range(3):
            vector[a] += T[i, a] * s[i]
            for b in range(len(vector)):
                for j in range(3):
                    matrix[a, b] += T[i, a] * S[i, j] * T[j, b]


@kernel
def _add_along(H: FloatArray, T: FloatArray, step: FloatArray, pull: FloatArray, moved: FloatArray) -> None:
    """Add the displacement T x of a point to ``moved``, and H T x to ``pull``."""
    for i in range(3):
        for a in range(len(step)):
            moved[i] += T[i, a] * step[a]
    for i in range(3):
        for j in range(3):
            pull[i] += H[i, j] * moved[j]


@kernel
def move_point(
    H: FloatArray, weight: float, pull: FloatArray, rotation: FloatArray, point: FloatArray, e: FloatArray
) -> None:
    """Write e = -(H + weight)^-1 pull, camera axes, and add it to a point (3,) in head axes."""
    inverse = np.empty((3, 3))
    invert_symmetric(H, weight, inverse)
    for i in range(3):
        e[i] = 0.0
        for j in range(3):
            e[i] -= inverse[i, j] * pull[j]
    for i in range(3):
        for j in range(3):
            point[i] += rotation[j, i] * e[j]


@kernel
def apply_step(state: FaceUnknowns, step: FloatArray) -> None:
    """Apply a step to pose and deformation: t + d, exp(w) R, a + da."""
    for i in range(POSE):
        state.moved[i] += step[i]
    for i in range(3):
        state.position[i] += step[i]
    for b in range(len(state.coefficients)):
        state.coefficients[b] += step[POSE + b]
    rotate_in_place(state.rotation, step[3:6])
