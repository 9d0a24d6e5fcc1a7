"""The 3-D view's data: points and axes of estimate and truth at every k-th frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.html.components import matched_truth, readable
from posetrack_cli.evaluation.html.packing import packed, quantisation, quantised, step_for
from posetrack_cli.evaluation.html.timebase import RowTable
from posetrack_cli.evaluation.metrics.catalogue import label_and_unit
from posetrack_cli.evaluation.subjects import KINDS
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations
from posetrack_cli.results.subject_kind import kind_of

AXIS_MM = 60.0
"""Length of the drawn axes of a rigid subject."""


def scene(
    evaluation: Evaluation, table: RowTable, limit: int, wanted_ns: Sequence[int]
) -> dict[str, Any] | None:
    """Return the embedded scene, or None if the result has neither points nor poses.

    Args:
        evaluation: the result.
        table: is asked for the frames shown.
        limit: about how many frames to show.
        wanted_ns: stamps of frames to show in any case.
    """
    track = evaluation.track
    if not len(track) or (track.points is None and not _has_axes(track)):
        return None
    rows, step = _rows(evaluation, limit, wanted_ns)
    estimate, truth = _estimate(track, rows), _truth(evaluation, rows)
    origin, grid = quantisation(estimate if truth is None else np.concatenate([estimate, truth]))
    count = _point_count(track)
    return {
        "points": len(rows),
        "at": table.add(rows),
        "every": step,
        "origin": origin.tolist(),
        "stepMm": grid,
        "pointCount": count,
        "names": [readable(name) for name in track.point_names] if count else [],
        "edges": _edges(track.point_parents) if count else [],
        "axes": _has_axes(track),
        "estimate": quantised(estimate, origin, grid),
        "truth": None if truth is None else quantised(truth, origin, grid),
        "readings": _readings(evaluation, rows),
    }


def _point_count(track: Track) -> int:
    return 0 if track.points is None else track.points.shape[1]


def _has_axes(track: Track) -> bool:
    """Whether axes are drawn: of a rigid subject, and of what has no points."""
    known = track.position is not None and track.quaternion is not None
    return known and (kind_of(track.subject).rigid or track.points is None)


def _estimate(track: Track, rows: IntArray) -> FloatArray:
    """Return what is drawn of the estimate, (R, D, 3): points, then origin and ends of the axes."""
    parts = [] if track.points is None else [track.points[rows]]
    if _has_axes(track):
        assert track.position is not None
        assert track.quaternion is not None
        parts.append(_axes(track.position[rows], track.quaternion[rows]))
    return np.concatenate(parts, axis=1)


def _truth(evaluation: Evaluation, rows: IntArray) -> FloatArray | None:
    """The same of the truth; what it does not know is NaN, and None if it knows nothing of it."""
    points = matched_truth(evaluation, lambda other: other.points, rows)
    position = matched_truth(evaluation, lambda other: other.position, rows)
    quaternion = matched_truth(evaluation, lambda other: other.quaternion, rows)
    track = evaluation.track
    count, has_axes = _point_count(track), _has_axes(track)
    drawn = np.full((len(rows), count + (4 if has_axes else 0), 3), np.nan)
    if points is not None and points.shape[1] == count:
        drawn[:, :count] = points
    if has_axes and position is not None and quaternion is not None:
        drawn[:, count:] = _axes(position, quaternion)
    return drawn if np.isfinite(drawn).any() else None


def _axes(position: FloatArray, quaternion: FloatArray) -> FloatArray:
    """Return (R, 4, 3) origin and ends of the axes of poses."""
    ends = position[:, None] + rotations.rotate(quaternion[:, None], AXIS_MM * np.eye(3))
    return np.concatenate([position[:, None], ends], axis=1)


def _rows(evaluation: Evaluation, limit: int, wanted_ns: Sequence[int]) -> tuple[IntArray, int]:
    """Every k-th frame, those that are wanted and, of each error, the frame where it is largest."""
    stamps = evaluation.track.stamp_ns
    step = step_for(len(stamps), limit)
    worst = [
        int(evaluation.series_stamp_ns[np.argmax(np.where(np.isfinite(values), values, -np.inf))])
        for name, values in evaluation.series.items()
        if name in KINDS[evaluation.subject].readings and np.isfinite(values).any()
    ]
    wanted = np.searchsorted(stamps, np.array([*wanted_ns, *worst], dtype=np.int64))
    rows = np.concatenate([np.arange(0, len(stamps), step), [len(stamps) - 1], wanted])
    return np.unique(np.clip(rows, 0, len(stamps) - 1)).astype(np.int64), step


def _edges(parents: tuple[int, ...]) -> list[list[int]]:
    return [[parent, child] for child, parent in enumerate(parents) if parent >= 0]


def _readings(evaluation: Evaluation, rows: IntArray) -> list[dict[str, Any]]:
    """Per-frame errors at the shown frames."""
    found: list[dict[str, Any]] = []
    at = np.searchsorted(evaluation.track.stamp_ns, evaluation.series_stamp_ns)
    for name in KINDS[evaluation.subject].readings:
        if name in evaluation.series:
            values = np.full(len(evaluation.track), np.nan)
            values[at] = evaluation.series[name]
            label, unit = label_and_unit(name)
            found.append({"label": label, "unit": unit, "value": packed(values[rows], "f4")})
    return found
