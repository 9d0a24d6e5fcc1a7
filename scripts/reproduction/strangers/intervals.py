"""Whether true joints lie within the intervals that a result states of its pose.

A result states variances of the pose's entries, not of joints; with J the derivative of a joint's coordinates
by the tangent vector and P the stated, diagonal covariance, to first order::

    var = diag(J diag(P) J^T) = sum_k J_k^2 P_kk

Of the wrist, which is the pose's position, that is what is stated; for other joints it leaves out how errors
of the entries hang together, which no result states.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.evaluate import EvalOptions
from posetrack_cli.evaluation.metrics.measures import Matched
from posetrack_cli.evaluation.metrics.pose_errors import inside_interval, normalised_squares
from posetrack_cli.hand.anatomy import HandAnatomy
from posetrack_cli.hand.kinematics import joint_jacobian
from posetrack_cli.hand.shape import HandShape, reshaped_anatomy
from posetrack_cli.hand.webxr import load_hand
from reproduction.strangers.measuring import Measured
from reproduction.strangers.options import ARM, EXACT, Options
from reproduction.strangers.people import Person
from reproduction.strangers.tool import draw


def joint_variances(anatomy: HandAnatomy, poses: FloatArray, variances: FloatArray) -> FloatArray:
    """Return the variances (N, 21, 3), mm^2, camera axes, of the joints of poses.

    Args:
        anatomy: of the hand.
        poses: (N, 22) position, mm, quaternion and angles, rad.
        variances: (N, 21) of the tangent vector's entries, mm^2 and rad^2.
    """
    found: FloatArray = np.einsum("njck,nk->njc", joint_jacobian(anatomy, poses) ** 2, variances)
    return found


def person_inside(person: Person, options: Options, measured: Measured) -> BoolArray | None:
    """Which true joint coordinates (M, 21, 3) lie within their 90 % intervals, with the person's mesh; None
    without a result."""
    task = options.task(person, ARM, EXACT)
    found = measured.evaluation(task, EXACT, EvalOptions())
    if found is None or found.truth is None or found.pairs is None:
        return None
    if found.truth.point_names != found.track.point_names:
        return None
    anatomy = _anatomy(person, options, measured.side(task, EXACT))
    matched = Matched(found.track, found.truth, found.pairs)
    poses = np.hstack([matched.of_estimate(name) for name in ("position", "quaternion", "shape")])
    variances = joint_variances(anatomy, poses, matched.of_estimate("pose_variance"))
    return inside_interval(
        normalised_squares(matched.of_truth("points") - matched.of_estimate("points"), variances)
    )


def _anatomy(person: Person, options: Options, side: str) -> HandAnatomy:
    """The person's bones, as the run had them: the mesh is drawn once more, with as few frames as can be."""
    with tempfile.TemporaryDirectory() as folder:
        draw(options.tool, Path(folder), person.recording(1))
        return reshaped_anatomy(load_hand(Path(folder, "hand.glb")).anatomy, side, HandShape())
