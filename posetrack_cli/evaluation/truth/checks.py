"""What every truth must fulfil, wherever it comes from."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import TruthError
from posetrack_cli.geometry.rotations import canonical

LENGTH_TOLERANCE = 1e-3
"""How far |q| of a truth may be from 1: four decimals leave 1e-4, what is no rotation mostly more."""


def unit_quaternions(quaternions: FloatArray, where: Callable[[int], str]) -> FloatArray:
    """Return quaternions (N, 4) of unit length with w >= 0.

    Args:
        quaternions: x y z w, rounded perhaps.
        where: says where a row is.

    Raises:
        TruthError: one is farther than ``LENGTH_TOLERANCE`` from unit length.
    """
    lengths = np.linalg.norm(quaternions, axis=1)
    bad = np.flatnonzero(~(np.abs(lengths - 1.0) <= LENGTH_TOLERANCE))
    if bad.size:
        raise TruthError(
            "quaternion is no rotation",
            where=where(int(bad[0])),
            found=f"length {lengths[bad[0]]:.6g}",
            expected="1",
        )
    return canonical(quaternions)


def check_point_names(names: Sequence[str], found: Sequence[str], where: object) -> None:
    """Raise unless a truth has every point of the estimate; further ones are no fault.

    Args:
        names: of the estimate's points.
        found: of the truth's points.
        where: the truth.

    Raises:
        TruthError: names the points that are missing, and those that the estimate does not have.
    """
    missing = [name for name in names if name not in found]
    others = [name for name in found if name not in names]
    if missing:
        raise TruthError(
            "truth has other points than the result",
            where=where,
            found=", ".join(others) if others else f"{len(found)} points",
            expected=f"also {', '.join(missing)}",
        )
