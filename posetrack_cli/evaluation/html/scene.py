"""The 3-D view's data: points and axes of estimate and truth at every k-th frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.evaluation.evaluation import Evaluation
from posetrack_cli.evaluation.html.components import matched_truth
from posetrack_cli.evaluation.html.downsample import step_for
from posetrack_cli.evaluation.html.labels import quantity_label, readable
from posetrack_cli.evaluation.html.packing import packed, quantisation, quantised
from posetrack_cli.evaluation.html.rows import RowTable
from posetrack_cli.evaluation.track import Track
from posetrack_cli.geometry import rotations

AXIS_MM = 60.0
"""Length of the drawn axes of a head."""

READINGS = ("joint_error_mm", "largest_joint_error_mm", "position_mm", "rotation_deg", "point_error_mm")
"""Errors that are told beside the view, as far as the evaluation has them."""


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
    estimate = _drawn(track, track.position, track.quaternion, track.points)
    if estimate is None or not len(track):
        return None
    truth = _true_drawn(evaluation, estimate.shape)
    rows, step = _rows(evaluation, limit, wanted_ns)
    shown = estimate[rows] if truth is None else np.concatenate([estimate[rows], truth[rows]])
    origin, grid = quantisation(shown)
    count = 0 if track.points is None else len(track.point_names)
    return {
        "points": len(rows),
        "at": table.add(rows),
        "every": step,
        "origin": origin.tolist(),
        "stepMm": grid,
        "pointCount": count,
        "names": [readable(name) for name in track.point_names] if count else [],
        "edges": _edges(track.point_parents) if count else [],
        "axes": estimate.shape[1] > count,
        "axisMm": AXIS_MM,
        "estimate": quantised(estimate[rows], origin, grid),
        "truth": None if truth is None else quantised(truth[rows], origin, grid),
        "readings": _readings(evaluation, rows),
    }


def _drawn(
    track: Track, position: FloatArray | None, quaternion: FloatArray | None, points: FloatArray | None
) -> FloatArray | None:
    """Return what is drawn, (N, D, 3): points; then of a head, or without points, origin and axis ends."""
    has_axes = position is not None and quaternion is not None and (track.subject == "head" or points is None)
    parts = [] if points is None else [points]
    if has_axes:
        assert position is not None
        assert quaternion is not None
        ends = position[:, None] + rotations.rotate(quaternion[:, None], AXIS_MM * np.eye(3))
        parts.append(np.concatenate([position[:, None], ends], axis=1))
    return np.concatenate(parts, axis=1) if parts else None


def _true_drawn(evaluation: Evaluation, shape: tuple[int, ...]) -> FloatArray | None:
    """The same of the truth at the estimate's frames; what it does not know is NaN."""
    points = matched_truth(evaluation, lambda other: other.points)
    position = matched_truth(evaluation, lambda other: other.position)
    quaternion = matched_truth(evaluation, lambda other: other.quaternion)
    if points is None and position is None:
        return None
    track = evaluation.track
    drawn = np.full(shape, np.nan)
    count = 0 if track.points is None else track.points.shape[1]
    if points is not None and points.shape[1] == count:
        drawn[:, :count] = points
    if shape[1] > count and position is not None and quaternion is not None:
        ends = position[:, None] + rotations.rotate(quaternion[:, None], AXIS_MM * np.eye(3))
        drawn[:, count:] = np.concatenate([position[:, None], ends], axis=1)
    return drawn


def _rows(evaluation: Evaluation, limit: int, wanted_ns: Sequence[int]) -> tuple[IntArray, int]:
    """Every k-th frame, those that are wanted and, of each error, the frame where it is largest."""
    stamps = evaluation.track.stamp_ns
    step = step_for(len(stamps), limit)
    worst = [
        int(evaluation.series_stamp_ns[np.argmax(np.where(np.isfinite(values), values, -np.inf))])
        for name, values in evaluation.series.items()
        if name in READINGS and np.isfinite(values).any()
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
    for name in READINGS:
        if name in evaluation.series:
            values = np.full(len(evaluation.track), np.nan)
            values[at] = evaluation.series[name]
            label, unit = quantity_label(name)
            found.append({"label": label, "unit": unit, "value": packed(values[rows], "f4")})
    return found
