"""The systematic part of the joints' errors: what a hand of other proportions leaves after any filter."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.alignment import tracked_pairs
from posetrack_cli.evaluation.metrics.measures import Common, Matched, Measures
from posetrack_cli.geometry.rotations import conjugate, rotate

BIAS = "joint_bias_mm"
COMPONENTS = tuple(f"joint_bias_{axis}_mm" for axis in "xyz")
BIAS_METRICS = (BIAS, *COMPONENTS)


def joint_bias(measures: Measures, matched: Matched, joints: Common) -> None:
    """Add the mean error vector of each joint in the palm's axes, over the frames that are not lost.

    With R_i the estimated rotation of the hand: b_j = mean_i R_i^T (p_ij - p_true,ij), mm, estimate minus
    truth. Of a right hand x points to the thumb, y to the wrist, z out of the back of the hand. The whole's
    length is the mean of |b_j| over the joints, its components are those of the mean of b_j.
    """
    if matched.estimate.quaternion is None:
        return measures.lack("the result has no rotation", *BIAS_METRICS)
    if not len(matched):
        return measures.lack(measures.nothing, *BIAS_METRICS)
    biases = _biases(matched, joints)
    _add(measures, BIAS, np.linalg.norm(biases, axis=1), joints.names)
    for component, values in zip(COMPONENTS, biases.T, strict=True):
        _add(measures, component, values, joints.names)


def _biases(matched: Matched, joints: Common) -> FloatArray:
    """(P, 3), one joint at a time: a long track's points are most of its memory."""
    track, truth = matched.estimate, matched.truth
    rows, true_rows = tracked_pairs(track, matched.pairs)
    assert track.quaternion is not None and track.points is not None and truth.points is not None
    back = conjugate(track.quaternion[rows])
    return np.array(
        [
            rotate(back, track.points[rows, mine] - truth.points[true_rows, theirs]).mean(axis=0)
            for mine, theirs in zip(joints.estimate, joints.truth, strict=True)
        ]
    )


def _add(measures: Measures, address: str, values: FloatArray, names: tuple[str, ...]) -> None:
    measures.metrics[address] = float(values.mean())
    measures.metrics |= {f"{address}.{name}": float(v) for name, v in zip(names, values, strict=True)}
