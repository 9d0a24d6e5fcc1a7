"""A pose fitted to the places of joints, compiled: Gauss-Newton with weights that points far off lose.

With e_k the difference of place and joint k along its axes and p_k their precisions, iteration by iteration

    s_k^2 = sum_i p_ki e_ki^2,        w_k = 1 / (1 + s_k^2 / c^2)^2  (Geman and McClure 1987)

weigh the joints' rows, c falling from ``_WIDEST`` to ``_NARROWEST`` standard deviations; the anatomy's
potential (``anatomy_terms``) keeps what no point tells plausible.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.compiled import kernel
from posetrack_cli.geometry import rotations
from posetrack_cli.geometry.least_squares import geman_mcclure, solve
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
    NO_INNER,
    PALM,
    Posed,
    Skeleton,
    empty_posed,
    point_row,
    pose_bones,
    skeleton_of,
)
from posetrack_cli.hand.model.anatomy import JOINT_NAMES, TANGENT_SIZE, HandAnatomy

_WIDEST, _NARROWEST = 12.0, 2.5
"""Standard deviations at which a point's weight is a quarter, in the first and in the last iteration."""
_ITERATIONS, _STEPS = 14, Steps(60.0, 0.6, 0.6)
_LEAST = (1e-4, 1e-2, 1e-2)
"""Precisions of position, 1 / mm^2, rotation and angles, 1 / rad^2, about the last iteration's pose."""


class PlacesToFit(NamedTuple):
    """Where the 21 joints are said to be.

    Attributes:
        places: (21, 3) camera axes, mm; anything where nothing is said.
        axes: (21, 3, 3) orthonormal rows: two across the line of sight and the one along it, away.
        precision: (21, 3) along these, 1 / mm^2; 0 where nothing is said.
        behind: (21,) factor on the third where the joint lies behind its place: below 1 where a surface told
            the place, which may be that of something in front of the joint.
    """

    places: FloatArray
    axes: FloatArray
    precision: FloatArray
    behind: FloatArray


class PointWorkspace(NamedTuple):
    """What one fit at a time writes to."""

    posed: Posed
    spheres: FloatArray
    equations: NormalEquations


def make_point_workspace() -> PointWorkspace:
    """Return the workspace of fits to points."""
    return PointWorkspace(empty_posed(), np.zeros((5, SPHERES, 3)), empty_equations())


@kernel
def _joint(posed: Posed, k: int, out: FloatArray) -> None:
    """Write joint k, in the order of ``JOINT_NAMES``, of a hand that is posed."""
    f, j = (k - 1) // 4, (k - 1) % 4
    for i in range(3):
        if k == 0:
            out[i] = posed.bones[0, i, 3]
        elif j == 3:
            out[i] = posed.tips[f, i]
        else:
            out[i] = posed.centres[f, j, i]


@kernel
def _misfit(about: PlacesToFit, k: int, at: FloatArray, e: FloatArray, p: FloatArray) -> float:
    """Write the difference (3,) of a place and its joint along its axes, and precisions; return s^2."""
    square = 0.0
    for i in range(3):
        e[i] = 0.0
        for j in range(3):
            e[i] += about.axes[k, i, j] * (about.places[k, j] - at[j])
        p[i] = about.precision[k, i]
        if i == 2 and e[i] < 0.0:
            p[i] *= about.behind[k]
        square += p[i] * e[i] * e[i]
    return square


@kernel
def _add_point(
    about: PlacesToFit, posed: Posed, k: int, width: float, reaches: FloatArray, equations: NormalEquations
) -> None:
    """Add the rows of one joint, moved by the palm and by the hinges before it."""
    at, e, p, row = np.empty(3), np.empty(3), np.empty(3), np.empty(ROW)
    _joint(posed, k, at)
    square = _misfit(about, k, at, e, p)
    weight = geman_mcclure(square / (width * width))
    hinges = (k - 1) % 4 if k else 0
    finger = (k - 1) // 4 if hinges else PALM
    for i in range(3):
        x, y, z = about.axes[k, i, 0], about.axes[k, i, 1], about.axes[k, i, 2]
        point_row(posed, finger, reaches, hinges, at[0], at[1], at[2], x, y, z, row)
        row[RESIDUAL] = e[i]
        add_row(equations, finger, row, weight * p[i])


@kernel
def fit_places(
    skeleton: Skeleton,
    plausibility: Plausibility,
    about: PlacesToFit,
    pose: FloatArray,
    most: Steps,
    iterations: int,
    workspace: PointWorkspace,
) -> None:
    """Move a start pose (22,) to places of joints.

    Args:
        skeleton, plausibility: the hand.
        about: the places; of three that are not on one line at least.
        pose: is written to.
        most: largest steps.
        iterations: how many.
        workspace: is written to.
    """
    posed, equations = workspace.posed, workspace.equations
    reaches = np.tri(4, 3, -1)  # row j: moved by the first j hinges
    step = np.empty(TANGENT_SIZE)
    for n in range(iterations):
        left = 1.0 - n / max(iterations - 1, 1)
        width = _NARROWEST * (_WIDEST / _NARROWEST) ** left
        pose_bones(skeleton, pose, NO_INNER, posed)
        clear(equations)
        for k in range(21):
            if about.precision[k, 0] > 0.0:
                _add_point(about, posed, k, width, reaches, equations)
        gather(equations)
        add_anatomy(plausibility, pose, posed, workspace.spheres, equations)
        for i in range(TANGENT_SIZE):
            equations.matrix[i, i] += _LEAST[0] if i < 3 else (_LEAST[1] if i < 6 else _LEAST[2])
        of_pose = equations.matrix[:TANGENT_SIZE, :TANGENT_SIZE].copy()  # inner numbers stay 0
        solve(of_pose, equations.vector[:TANGENT_SIZE].copy(), step)
        step_pose(pose, step, most)


@kernel
def misfits(skeleton: Skeleton, about: PlacesToFit, pose: FloatArray, posed: Posed, out: FloatArray) -> None:
    """Write s (21,) of a pose (22,): how many standard deviations each joint is off its place."""
    at, e, p = np.empty(3), np.empty(3), np.empty(3)
    pose_bones(skeleton, pose, NO_INNER, posed)
    for k in range(21):
        _joint(posed, k, at)
        out[k] = np.sqrt(_misfit(about, k, at, e, p))


class PlaceFitter:
    """Lays a hand on places of its joints.

    Args:
        anatomy: the hand. No finger is hidden whose joints are told, so where closing and straight fingers
            usually are, and how their neighbours bend, is no evidence.
        all_told: whether that is so of all fingers. If not, ligaments hold bent ones in their usual planes.
    """

    def __init__(self, anatomy: HandAnatomy, *, all_told: bool) -> None:
        self._skeleton, self._workspace = skeleton_of(anatomy), make_point_workspace()
        about = plausibility_of(anatomy)
        self._plausibility = about._replace(
            resting_odds=-np.inf,
            closing_odds=-np.inf,
            straight_odds=-np.inf,
            alike_weight=0.0,
            taut=0.0 if all_told else about.taut,
        )

    def fit(self, about: PlacesToFit, pose: FloatArray) -> None:
        """Move a pose (22,) to places (``fit_places``)."""
        fit_places(self._skeleton, self._plausibility, about, pose, _STEPS, _ITERATIONS, self._workspace)

    def misfits(self, about: PlacesToFit, pose: FloatArray) -> FloatArray:
        """Return how many standard deviations each joint (21,) of a pose (22,) is off its place."""
        off = np.empty(len(JOINT_NAMES))
        misfits(self._skeleton, about, pose, self._workspace.posed, off)
        return off


def lay_on(about: PlacesToFit, known: IntArray, joints: FloatArray, pose: FloatArray) -> FloatArray:
    """Lay a hand that does not bend on places, as well as it can be; return its rotation (3, 3).

    Args:
        about: the places.
        known: which of them count.
        joints: (21, 3) of the pose as it is: at the origin, not turned.
        pose: (22,) is written to.
    """
    turn, pose[:3] = rigid_alignment(joints[known], about.places[known], about.precision[known, 0])
    pose[3:7] = rotations.canonical(rotations.quaternions_from_matrices(turn))
    return turn
