"""A trajectory as arrays: of a result, or of a truth from wherever it comes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.association import check_stamps
from posetrack_cli.outputs import part_path
from posetrack_cli.results.columns import Columns
from posetrack_cli.results.estimate import Status, Subject
from posetrack_cli.results.fields import FIELD_NAMES, NUMBERS
from posetrack_cli.results.reader import Result
from posetrack_cli.results.tracks import FILTERED

MOTION_FIELDS = ("stamp_ns", "status", "position", "quaternion", "shape", "twist", "points")
"""What a truth is made from, of the fields of an Estimate."""
_TRACK_FIELDS = tuple(name for name in FIELD_NAMES if name != "pose_rate")  # twist says the same


@dataclass(frozen=True, eq=False)
class Track:
    """A trajectory, frames (N) along the first axis of every array, stamps strictly increasing.

    What a source does not know is None: a CSV of joints has no pose, a random walk no velocity.
    K shape entries (finger angles, rad; deformation coefficients), P points (joints, landmarks).

    Attributes:
        name: what tables and errors call it.
        subject: ``hand`` or ``head``.
        shape_names: K names.
        point_names: P names.
        point_parents: P indices, -1 for a root; empty when the source does not tell.
        stamp_ns: (N,) integer nanoseconds.
        lost: (N,) frames whose status is lost; None for a truth.
        reinitialised: (N,) frames whose status is reinitialised; None for a truth.
        position: (N, 3) mm, camera axes.
        quaternion: (N, 4) x y z w, unit, w >= 0: rotation of ``camera_T_object``.
        shape: (N, K).
        twist: (N, 6 + K) mm/s in camera axes; rad/s in the body frame; shape per second.
        pose_variance: (N, 6 + K) mm^2, rad^2 (rotation vector, body frame), shape^2.
        twist_variance: (N, 6 + K) of ``twist``.
        points: (N, P, 3) mm, camera axes.
        confidence, cost, effective_sample_size, milliseconds, evaluations: (N,); NaN where unknown.
        resampled: (N,).
        frame_index: (N,) positions of the frames in the recording; None where unknown, of a truth unless it
            is matched by them.
        numbers: (N, M) further numbers of the tracker; NaN where unknown.
        number_names: what it calls them.
        pixels: (N, P, 2) points in the images, of a truth that has nothing else.
    """

    name: str
    subject: str
    shape_names: tuple[str, ...]
    point_names: tuple[str, ...]
    point_parents: tuple[int, ...]
    stamp_ns: IntArray
    lost: BoolArray | None = None
    reinitialised: BoolArray | None = None
    position: FloatArray | None = None
    quaternion: FloatArray | None = None
    shape: FloatArray | None = None
    twist: FloatArray | None = None
    pose_variance: FloatArray | None = None
    twist_variance: FloatArray | None = None
    points: FloatArray | None = None
    confidence: FloatArray | None = None
    cost: FloatArray | None = None
    effective_sample_size: FloatArray | None = None
    evaluations: FloatArray | None = None
    milliseconds: FloatArray | None = None
    resampled: BoolArray | None = None
    frame_index: IntArray | None = None
    numbers: FloatArray | None = None
    number_names: tuple[str, ...] = ()
    pixels: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def status(self, row: int) -> Status:
        """The status of a frame; of a track that does not say, tracking."""
        if self.lost is not None and self.lost[row]:
            return Status.LOST
        if self.reinitialised is not None and self.reinitialised[row]:
            return Status.REINITIALISED
        return Status.TRACKING


def track_of_result(result: Result, name: str, which: str = FILTERED) -> Track:
    """Return the estimates of one of a result's tracks, lost ones included.

    Args:
        result: finished or not; what of it cannot be read is in ``result.losses`` afterwards.
        name: what tables and errors call it.
        which: ``filtered`` or ``smoothed``.

    Raises:
        ResultError: nothing can be read, the stamps do not increase strictly, or there is no such track.
    """
    further = (NUMBERS,) if result.subject.number_names else ()
    columns = result.columns(result.topic_of_track(which), _TRACK_FIELDS + further)
    status = columns["status"]
    return Track(
        **_motion(columns, name, result.subject),
        lost=status == Status.LOST.value,
        reinitialised=status == Status.REINITIALISED.value,
        pose_variance=_known(columns["pose_variance"]),
        twist_variance=_known(columns["twist_variance"]),
        confidence=columns["confidence"],
        cost=columns["cost"],
        effective_sample_size=_known(columns["effective_sample_size"]),
        milliseconds=columns["milliseconds"],
        evaluations=_known(columns["evaluations"]),
        resampled=columns["resampled"],
        frame_index=columns["frame_index"],
        numbers=columns.get(NUMBERS),
        number_names=result.subject.number_names,
    )


def truth_of_columns(columns: Columns, name: str, subject: Subject) -> Track:
    """Return the trajectory of estimates that are taken for the truth.

    It has no status, variances and particles of its own. Estimates that are lost are no truth and are left
    out: frames without a truth count as unmatched.

    Args:
        columns: of ``MOTION_FIELDS``.
        name: what tables and errors call it.
        subject: whose shape entries and points they are.

    Raises:
        ResultError: the stamps do not increase strictly.
    """
    known = columns["status"] != Status.LOST.value
    if not known.all():
        columns = {key: column[known] for key, column in columns.items()}
        name = f"{name} without its {int((~known).sum())} lost frames"
    return Track(**_motion(columns, name, subject))


def _motion(columns: Columns, name: str, subject: Subject) -> dict[str, Any]:
    """Return what estimate and truth have in common."""
    check_stamps(columns["stamp_ns"], name)
    return {
        "name": name,
        "subject": subject.name,
        "shape_names": subject.shape_names,
        "point_names": subject.point_names,
        "point_parents": subject.point_parents,
        "stamp_ns": columns["stamp_ns"],
        "position": columns["position"],
        "quaternion": columns["quaternion"],
        "shape": columns["shape"],
        "twist": _known(columns["twist"]),
        "points": columns["points"] if subject.point_names else None,
    }


def _known(column: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """Return the column, or None if no message had it."""
    return None if len(column) and np.isnan(column).all() else column


_PART = part_path(Path("x")).suffix


def plain_name(path: Path) -> str:
    """Return a file's name without folder and ending; NAME.part of an unfinished run counts as NAME.

    Line ends, control codes and bytes of no encoding, which a terminal would obey, are written as escapes.
    """
    return _printable(Path(path.name.removesuffix(_PART)).stem)


def unique_names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each path: its plain name, with the folder's where plain names are alike.

    What is still alike, such as one file given twice, is numbered.
    """
    plain = [plain_name(path) for path in paths]
    counts = Counter(plain)
    with_folder = [
        name if counts[name] == 1 else f"{_printable(path.absolute().parent.name)}/{name}"
        for name, path in zip(plain, paths, strict=True)
    ]
    unique: list[str] = []
    for name in with_folder:
        unique.append(_free(name, unique))
    return unique


def track_name(name: str, which: str, taken: Sequence[str]) -> str:
    """Return what a track is called beside others of its result: the filtered one as the result itself."""
    return name if which == FILTERED else _free(f"{name} {which}", taken)


def _printable(name: str) -> str:
    return "".join(sign if sign.isprintable() else ascii(sign)[1:-1] for sign in name)


def _free(name: str, taken: Sequence[str]) -> str:
    """The name, or the first ``name (2)``, ``name (3)``, ... that is not taken."""
    number = 2
    free = name
    while free in taken:
        free, number = f"{name} ({number})", number + 1
    return free
