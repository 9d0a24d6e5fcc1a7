"""What every truth must fulfil, and what makes one look like that of something else."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.errors import TruthError
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry.rotations import canonical
from posetrack_cli.mcap.stream import is_mcap
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.results.reader import Result, is_result, read_result

LENGTH_TOLERANCE = 1e-3
"""How far |q| of a truth may be from 1: four decimals leave 1e-4, what is no rotation mostly more."""


LIKE_METRES = (500.0, 2000.0)
"""How much farther away an estimate is than a truth in metres: 1000 times, give or take an error."""


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


def truth_warnings(result: Result, track: Track, truth: Track, path: Path | None) -> Iterator[str]:
    """Yield a note for each reason to doubt that a truth is of what a result is of.

    Args:
        result: what is measured.
        track: its estimates.
        truth: what they are measured against.
        path: the file that it was taken from; None for what the result carries.
    """
    if truth.pixels is not None:
        yield f"the truth has only image points: {truth.name}"
    if path is not None and _of_another_recording(result, path):
        yield f"the truth {path.name} was made from another recording than the result"
    distance, true_distance = _distance_mm(track), _distance_mm(truth)
    if LIKE_METRES[0] < distance / true_distance < LIKE_METRES[1]:
        yield (
            f"the truth is {true_distance:.3g} mm from the camera, the estimate {distance:.3g} mm: "
            "is it in metres?"
        )


def _of_another_recording(result: Result, path: Path) -> bool:
    """Whether a truth is another run's estimates, and both say what they were made from."""
    if path.is_dir() or not (is_mcap(path) and is_result(path)):
        return False
    mine, its = result.run.get(RECORDING_KEY), read_result(path).run.get(RECORDING_KEY)
    return bool(mine and its and mine != its)


def _distance_mm(track: Track) -> float:
    """The median distance from the camera; NaN where a track does not tell it."""
    places = track.position if track.position is not None else _first_point(track)
    if places is None or not len(places):
        return float("nan")
    return float(np.median(np.linalg.norm(places, axis=1))) or float("nan")


def _first_point(track: Track) -> FloatArray | None:
    return None if track.points is None else track.points[:, 0]
