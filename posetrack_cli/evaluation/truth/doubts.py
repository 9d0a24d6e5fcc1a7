"""What makes a truth look like one of something else: told beside the figures, since it may be meant."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from posetrack_cli.arrays import FloatArray
from posetrack_cli.evaluation.track import Track
from posetrack_cli.mcap.stream import is_mcap
from posetrack_cli.recording.base import RECORDING_KEY
from posetrack_cli.results.reader import Result, is_result, read_result

LIKE_METRES = (500.0, 2000.0)
"""How much farther away an estimate is than a truth in metres: 1000 times, give or take an error."""


def doubts(result: Result, track: Track, truth: Track, path: Path | None) -> Iterator[str]:
    """Yield a note for each reason to doubt that a truth is of what a result is of.

    Args:
        result: what is measured.
        track: its estimates.
        truth: what they are measured against.
        path: the file that it was taken from; None for what the result carries.
    """
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
    if not (is_mcap(path) and is_result(path)):
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
