"""Which frames are adjusted together: those that show the face in different directions (thesis, 4.3.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.geometry.rotations import matrices_from_quaternions
from posetrack_cli.head.adjustment.views import PointView


def with_new(views: Sequence[PointView], new: PointView, count: int) -> tuple[PointView, ...]:
    """Return the frames for the next adjustment; the new one is the last.

    While there are fewer than ``count`` it is added. Then it replaces one: that without which the directions
    of the others and the new one vary most, ``spread``. Of equal ones the oldest in order goes.

    Args:
        views: frames of the last adjustment.
        new: the present frame.
        count: n, at least 1.
    """
    kept = list(views)
    while len(kept) >= count:
        facing = matrices_from_quaternions(np.array([view.pose.quaternion for view in (*kept, new)]))[..., 2]
        del kept[int(np.argmax(spreads_without(facing)[:-1]))]
    return (*kept, new)


def spread(facing: FloatArray) -> float:
    """Return the variance of directions: the sum of the variances of unit vectors' components **[ours]**.

    It is 1 - |mean|^2, 0 for equal directions; about the variance of yaw plus that of pitch, rad^2, where
    they are small, and unlike that the same however the camera is turned.

    Args:
        facing: (n, 3) unit vectors.
    """
    mean = facing.mean(axis=0)
    return float(1.0 - mean @ mean)


def spreads_without(facing: FloatArray) -> FloatArray:
    """Return (n,) the spread of the others without each of n >= 2 directions (n, 3); time linear in n."""
    means = (facing.sum(axis=0) - facing) / (len(facing) - 1)
    spreads: FloatArray = 1.0 - np.einsum("ni,ni->n", means, means)
    return spreads
