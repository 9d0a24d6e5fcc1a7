"""Fit of a pose to joint targets by robust Gauss-Newton; compiled.

With e_k the difference of target and joint k along the target's axes and p_k its precisions, each iteration
weights the rows of joint k by

    s_k^2 = sum_i p_ki e_ki^2,        w_k = 1 / (1 + s_k^2 / c^2)^2  (Geman and McClure 1987)

where c falls from ``_MAX_WIDTH`` to ``_MIN_WIDTH`` standard deviations. The anatomical potential
(``anatomy_terms``) constrains joints without a target.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.compiled import borrowing, kernel
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.least_squares import geman_mcclure, solve_positive
from posetrack_cli.geometry.rigid import rigid_alignment
from posetrack_cli.hand.fit.anatomy_terms import SPHERES, Plausibility, add_anatomy, plausibility_of
from posetrack_cli.hand.fit.gauss_newton import Steps, step_pose
from posetrack_cli.hand.fit.normal_equations import (
    RESIDUAL,
    ROW,
    NormalEquations,
    add_row,
    clear,
    empty_equations,
    gather,
)
from posetrack_cli.hand.fit.skeleton import (
    INNER_SIZE,
    PALM,
    Posed,
    Skeleton,
    empty_posed,
    point_row,
    pose_bones,
    skeleton_of,
)
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, TANGENT_SIZE, HandAnatomy

_MAX_WIDTH, _MIN_WIDTH = 12.0, 2.5
"""Residual, in standard deviations, at which a point's weight is 1/4, in the first and last iteration."""
_ITERATIONS, _STEPS = 14, Steps(60.0, 0.6, 0.6)
_MIN_PRECISION = (1e-4, 1e-2, 1e-2)
"""Precisions of position, 1 / mm^2, rotation and angles, 1 / rad^2, around the last iteration's pose."""


class JointTargets(NamedTuple):
    """Target positions of the 21 joints.

    Attributes:
        positions: (21, 3) camera axes, mm; arbitrary where the precision is 0.
        axes: (21, 3, 3) orthonormal rows: two across the line of sight, and the line of sight itself, away
            from the camera.
        precision: (21, 3) along these, 1 / mm^2; 0 for unknown joints.
        behind: (21,) factor on the third precision for a joint behind its target: < 1 where the target comes
            from a surface that may occlude the joint.
    """

    positions: FloatArray
    axes: FloatArray
    precision: FloatArray
    behind: FloatArray


class PointWorkspace(NamedTuple):
    """Buffers of one fit at a time."""

    posed: Posed
    spheres: FloatArray
    equations: NormalEquations


def make_point_workspace() -> PointWorkspace:
    """Return the buffers of fits to points."""
    return PointWorkspace(empty_posed(), np.zeros((5, SPHERES, 3)), empty_equations())


@borrowing
def _joint(posed: Posed, k: int, out: FloatArray) -> None:
    """Write joint k of a posed hand, in the order of ``JOINT_NAMES``."""
    f, j = (k - 1) // 4, (k - 1) % 4
    for i in range(3):
        if k == 0:
            out[i] = posed.bones[0, i, 3]
        elif j == 3:
            out[i] = posed.tips[f, i]
        else:
            out[i] = posed.centres[f, j, i]


@borrowing
def _misfit(targets: JointTargets, k: int, at: FloatArray, e: FloatArray, p: FloatArray) -> float:
    """Write difference and precisions (3,) of a joint along its target's axes; return s^2."""
    square = 0.0
    for i in range(3):
        e[i] = 0.0
        for j in range(3):
            e[i] += targets.axes[k, i, j] * (targets.positions[k, j] - at[j])
        p[i] = targets.precision[k, i]
        if i == 2 and e[i] < 0.0:
            p[i] *= targets.behind[k]
        square += p[i] * e[i] * e[i]
    return square


@kernel
def _add_point(
    targets: JointTargets, posed: Posed, k: int, width: float, reaches: FloatArray, equations: NormalEquations
) -> None:
    """Add the rows of one joint, which moves with the palm and the hinges before it."""
    at, e, p, row = np.empty(3), np.empty(3), np.empty(3), np.zeros(ROW)
    _joint(posed, k, at)
    square = _misfit(targets, k, at, e, p)
    weight = geman_mcclure(square / (width * width))
    hinges = (k - 1) % 4 if k else 0
    finger = (k - 1) // 4 if hinges else PALM
    for i in range(3):
        x, y, z = targets.axes[k, i, 0], targets.axes[k, i, 1], targets.axes[k, i, 2]
        point_row(posed, finger, reaches, hinges, at[0], at[1], at[2], x, y, z, row)
        row[RESIDUAL] = e[i]
        add_row(equations, finger, row, weight * p[i])


@kernel
def fit_targets(
    skeleton: Skeleton,
    plausibility: Plausibility,
    targets: JointTargets,
    pose: FloatArray,
    most: Steps,
    iterations: int,
    workspace: PointWorkspace,
) -> None:
    """Fit a pose (22,) to joint targets, in place.

    Args:
        skeleton, plausibility: the hand.
        targets: at least three of them, not collinear.
        pose: start; overwritten.
        most: step limits.
        iterations: number of iterations.
        workspace: overwritten.
    """
    posed, equations = workspace.posed, workspace.equations
    reaches, step, inner = np.zeros((4, 3)), np.empty(TANGENT_SIZE), np.zeros(INNER_SIZE)
    for j in range(4):  # moved by the first j hinges; np.tri takes seconds to compile
        for i in range(j):
            reaches[j, i] = 1.0
    for n in range(iterations):
        remaining = 1.0 - n / max(iterations - 1, 1)
        width = _MIN_WIDTH * (_MAX_WIDTH / _MIN_WIDTH) ** remaining
        pose_bones(skeleton, pose, inner, posed)
        clear(equations)
        for k in range(21):
            if targets.precision[k, 0] > 0.0:
                _add_point(targets, posed, k, width, reaches, equations)
        gather(equations)
        add_anatomy(plausibility, pose, posed, workspace.spheres, equations)
        for i in range(TANGENT_SIZE):
            equations.matrix[i, i] += (
                _MIN_PRECISION[0] if i < 3 else (_MIN_PRECISION[1] if i < 6 else _MIN_PRECISION[2])
            )
        solve_positive(equations.matrix, equations.vector, step)  # inner numbers are not fitted
        step_pose(pose, step, most)


@kernel
def misfits(
    skeleton: Skeleton, targets: JointTargets, pose: FloatArray, posed: Posed, out: FloatArray
) -> None:
    """Write s (21,) of a pose (22,): the distance of each joint from its target in standard deviations."""
    at, e, p, inner = np.empty(3), np.empty(3), np.empty(3), np.zeros(INNER_SIZE)
    pose_bones(skeleton, pose, inner, posed)
    for k in range(21):
        _joint(posed, k, at)
        out[k] = np.sqrt(_misfit(targets, k, at, e, p))


class TargetFitter:
    """Fits a hand to joint targets.

    Args:
        anatomy: the hand.
        all_known: whether all fingers have targets. If not, ligaments keep bent fingers in their usual
            planes.
    """

    def __init__(self, anatomy: HandAnatomy, *, all_known: bool) -> None:
        self._skeleton, self._workspace = skeleton_of(anatomy), make_point_workspace()
        potential = plausibility_of(anatomy)
        # priors for hidden fingers do not apply: joints with targets are visible
        self._plausibility = potential._replace(
            resting_odds=-np.inf,
            closing_odds=-np.inf,
            straight_odds=-np.inf,
            alike_weight=0.0,
            taut=0.0 if all_known else potential.taut,
        )

    def fit(self, targets: JointTargets, pose: FloatArray) -> None:
        """Fit a pose (22,) in place (``fit_targets``)."""
        fit_targets(self._skeleton, self._plausibility, targets, pose, _STEPS, _ITERATIONS, self._workspace)

    def misfits(self, targets: JointTargets, pose: FloatArray) -> FloatArray:
        """Return the distance (21,) of each joint of a pose (22,) from its target, in standard deviations."""
        off = np.empty(len(JOINT_NAMES))
        misfits(self._skeleton, targets, pose, self._workspace.posed, off)
        return off


def align_rigidly(targets: JointTargets, known: IntArray, joints: FloatArray, pose: FloatArray) -> FloatArray:
    """Align a rigid hand with joint targets; return its rotation (3, 3).

    Args:
        targets: the targets.
        known: indices of those used.
        joints: (21, 3) of the pose at the origin without rotation.
        pose: (22,) overwritten.
    """
    turn, pose[:3] = rigid_alignment(joints[known], targets.positions[known], targets.precision[known, 0])
    pose[3:7] = rotations.canonical(rotations.quaternions_from_matrices(turn))
    return turn
