"""Data of the plots and the 3D view of the HTML report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.html.components import components, matched_truth, readable
from posetrack_cli.evaluation.html.packing import (
    Packed,
    envelope_rows,
    packed,
    quantisation,
    quantised,
    step_for,
)
from posetrack_cli.evaluation.measuring.catalogue import label_and_unit, place_of
from posetrack_cli.evaluation.measuring.evaluation import Evaluation, Statistics
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames, reliability, roc_area, roc_curve
from posetrack_cli.evaluation.measuring.pooling import Pool
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.evaluation.measuring.without_truth import run_series
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.evaluation.viewing.pictures import Picture
from posetrack_cli.geometry import rotations
from posetrack_cli.recording.timeline import GAP_FACTOR
from posetrack_cli.results.estimate import kind_of

# Reduction of evaluations to the data of the plots


@dataclass(frozen=True)
class Budget:
    """Amount of data per result, which limits the size of the page.

    Attributes:
        quantity_points: points of each line of the plot over time.
        component_points: points of each component of the trajectories.
        scene_frames: frames of the 3D view.
    """

    quantity_points: int
    component_points: int
    scene_frames: int


def budget_for(results: int) -> Budget:
    """Return the budget of each result for a number of results."""
    share = max(1, results)
    return Budget(max(300, 6000 // share), max(100, 2500 // share), max(100, 5000 // share))


def page_data(
    evaluations: Sequence[Evaluation], pictures: Mapping[str, Sequence[Picture]], pools: Sequence[Pool] = ()
) -> dict[str, Any]:
    """Return the data of the page's scripts for ``packing.json_text``.

    Arrays are packed. Lines and scenes refer to frames by their index in the ``kept`` table of the result.
    """
    bases, shared = timebases([evaluation.track for evaluation in evaluations])
    budget = budget_for(len(evaluations))
    return {
        "sharedTime": shared,
        "tickSeconds": bases[0].tick_s if bases else 1.0,
        "results": [
            _result(evaluation, base, budget, pictures.get(evaluation.name, ()))
            for evaluation, base in zip(evaluations, bases, strict=True)
        ],
        "pools": [
            {"name": pool.name, "honesty": _honesty(pool.judged)} for pool in pools if pool.has_pooled_values
        ],
    }


def _result(
    evaluation: Evaluation, base: Timebase, budget: Budget, pictures: Sequence[Picture]
) -> dict[str, Any]:
    track = evaluation.track
    table = RowTable(track, base)
    lost = np.zeros(len(track), dtype=np.bool_) if track.lost is None else track.lost
    data: dict[str, Any] = {
        "name": evaluation.name,
        "subject": evaluation.subject,
        "frames": len(track),
        "quantities": _quantities(evaluation, table, budget.quantity_points),
        "curve": _curve(evaluation),
        "honesty": _honesty(evaluation.judged),
        "components": _components(evaluation, table, budget.component_points),
        "parts": _parts(evaluation),
        "scene": scene(evaluation, table, budget.scene_frames, [one.stamp_ns for one in pictures]),
        "lost": base.seconds(state_spans(track.stamp_ns, lost)).tolist(),
        "gaps": base.seconds(gap_spans(track.stamp_ns)).tolist(),
        "pictures": base.seconds(np.array([one.stamp_ns for one in pictures], dtype=np.int64)).tolist(),
    }
    return data | {"kept": table.finish()}


def _quantities(evaluation: Evaluation, table: RowTable, limit: int) -> dict[str, Any]:
    """Return the per-frame values by metric, of the series and of the run."""
    lines = evaluation.placed_series() | run_series(evaluation.track)
    found: dict[str, Any] = {}
    for name in sorted(lines, key=place_of):
        values = lines[name]
        if np.isfinite(values).any():
            rows = envelope_rows(values[None], limit)
            label, unit = label_and_unit(name)
            found[name] = {
                "label": label,
                "unit": unit,
                "points": len(rows),
                "at": table.add(rows),
                "value": packed(values[rows], "f4"),
            }
    return found


def _components(evaluation: Evaluation, table: RowTable, limit: int) -> list[dict[str, Any]]:
    found = []
    for one in components(evaluation):
        lines = [one.estimate] if one.truth is None else [one.estimate, one.truth]
        if not any(np.isfinite(line).any() for line in lines):
            continue  # an empty plot would only take space
        rows = envelope_rows(np.stack(lines), limit)
        found.append(
            {
                "group": one.group,
                "label": one.label,
                "unit": one.unit,
                "points": len(rows),
                "at": table.add(rows),
                "estimate": packed(one.estimate[rows], "f4"),
                "truth": None if one.truth is None else packed(one.truth[rows], "f4"),
                "halfWidth": None if one.half_width is None else packed(one.half_width[rows], "f4"),
            }
        )
    return found


def _curve(evaluation: Evaluation) -> dict[str, Any] | None:
    curve = evaluation.curve
    if curve is None:
        return None
    return {
        "thresholds": np.round(curve.thresholds_mm, 6).tolist(),
        "share": np.round(curve.share, 6).tolist(),
        "meanShare": np.round(curve.mean_share, 6).tolist(),
    }


def _honesty(judged: JudgedFrames | None) -> dict[str, Any] | None:
    """Return the reliability diagram, without empty bins, and the ROC curve."""
    if judged is None or not len(judged.scored[0]):
        return None
    bins = [one for one in reliability(*judged.scored) if one.count]
    curve = roc_curve(*judged.scored)
    return {
        "confidence": [round(one.confidence, 6) for one in bins],
        "right": [round(one.right, 6) for one in bins],
        "count": [one.count for one in bins],
        "roc": None
        if curve is None
        else {
            "confidence": curve.confidence.tolist(),
            "rightKept": np.round(curve.right_kept, 6).tolist(),
            "wrongKept": np.round(curve.wrong_kept, 6).tolist(),
            "area": roc_area(*judged.scored),
        },
    }


def _parts(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Return the error of each joint or point."""
    metric = KINDS[evaluation.subject].point_metric
    found = []
    for name in evaluation.track.point_names:
        value = evaluation.metrics.get(f"{metric}.{name}")
        if isinstance(value, Statistics) and value.count:
            found.append({"label": readable(name), "mean": value.mean, "p95": value.p95})
    return found


# Time axis and frame table


TICK_NS = 100_000
"""0.1 ms: much shorter than a frame, and 31 bits last for 59 hours."""

MOST_TICKS = 2**31 - 1
MOST_SPANS = 1000
"""Maximum number of spans; more are not distinguishable in a plot, so the closest ones are merged."""


@dataclass(frozen=True)
class Timebase:
    """Time origin and resolution of a result.

    Attributes:
        origin_ns: stamp of time 0.
        tick_ns: length of a tick.
    """

    origin_ns: int
    tick_ns: int

    def ticks(self, stamp_ns: IntArray) -> IntArray:
        """Return stamps as whole ticks since the origin."""
        return (stamp_ns - self.origin_ns) // self.tick_ns

    @property
    def tick_s(self) -> float:
        """Length of a tick, s."""
        return self.tick_ns * 1e-9

    def seconds(self, stamp_ns: IntArray) -> FloatArray:
        """Return stamps as seconds since the origin, rounded to ticks like in the scripts."""
        return self.ticks(stamp_ns).astype(np.float64) * self.tick_s


def timebases(tracks: Sequence[Track]) -> tuple[list[Timebase], bool]:
    """Return the time base of each track, and whether all have the same origin.

    Tracks that overlap in time share the first stamp as origin; otherwise each starts at its own first frame.
    """
    filled = [track.stamp_ns for track in tracks if len(track)]
    if not filled:
        return [Timebase(0, TICK_NS) for _ in tracks], True
    first, last = [int(stamps[0]) for stamps in filled], [int(stamps[-1]) for stamps in filled]
    shared = max(first) <= min(last)
    longest = max(last) - min(first) if shared else max(b - a for a, b in zip(first, last, strict=True))
    tick_ns = max(TICK_NS, -(-longest // MOST_TICKS))  # -(-a // b) rounds up
    starts = [int(track.stamp_ns[0]) if len(track) and not shared else min(first) for track in tracks]
    return [Timebase(start, tick_ns) for start in starts], shared


def gap_spans(stamp_ns: IntArray) -> IntArray:
    """Return the stamps (G, 2) before and after the gaps, at most the ``MOST_SPANS`` longest ones.

    Gaps are defined as for the metric ``gaps``: intervals longer than ``GAP_FACTOR`` times the median.
    """
    steps = np.diff(stamp_ns)
    if not len(steps):
        return np.empty((0, 2), dtype=np.int64)
    gaps = np.flatnonzero(steps > GAP_FACTOR * np.median(steps))
    if len(gaps) > MOST_SPANS:
        gaps = np.sort(gaps[np.argsort(-steps[gaps], kind="stable")[:MOST_SPANS]])
    return np.stack([stamp_ns[gaps], stamp_ns[gaps + 1]], axis=1)


def state_spans(stamp_ns: IntArray, holds: BoolArray) -> IntArray:
    """Return the stamps (S, 2) of the first and last frame of each run of frames where ``holds`` is True.

    If there are more than ``MOST_SPANS`` runs, those with the shortest pauses in between are merged.
    """
    edges = np.diff(np.concatenate([[False], holds, [False]]).astype(np.int8))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    if len(first) > MOST_SPANS:
        pauses = stamp_ns[first[1:]] - stamp_ns[last[:-1]]
        cuts = np.sort(np.argsort(-pauses, kind="stable")[: MOST_SPANS - 1])
        first, last = first[np.concatenate([[0], cuts + 1])], last[np.concatenate([cuts, [len(last) - 1]])]
    return np.stack([stamp_ns[first], stamp_ns[last]], axis=1)


TRACKING, LOST, REINITIALISED = 0, 1, 2


class RowTable:
    """Collects rows of a track, so that times, frame numbers and states are embedded only once.

    ``add`` returns a placeholder that ``finish`` fills with the indices of the rows in the table.
    """

    def __init__(self, track: Track, timebase: Timebase) -> None:
        self._track = track
        self._timebase = timebase
        self._waiting: list[tuple[IntArray, Packed]] = []

    def add(self, rows: IntArray) -> Packed:
        """Add rows of the track; the returned mapping has their indices after ``finish``."""
        places: Packed = {}
        self._waiting.append((rows, places))
        return places

    def finish(self) -> dict[str, Packed]:
        """Fill all placeholders and return the table: ticks, frame numbers and states."""
        asked = [rows for rows, _ in self._waiting]
        kept = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *asked]))
        for rows, places in self._waiting:
            places.update(packed(np.searchsorted(kept, rows), "u4"))
        return {
            "ticks": packed(self._timebase.ticks(self._track.stamp_ns[kept]), "i4"),
            "frames": packed(self._frame_numbers()[kept], "u4"),
            "states": packed(self._states()[kept], "u1"),
        }

    def _frame_numbers(self) -> IntArray:
        """Return frame numbers in the recording, or row numbers if they are unknown."""
        known = self._track.frame_index
        return np.arange(len(self._track), dtype=np.int64) if known is None else known

    def _states(self) -> IntArray:
        states = np.full(len(self._track), TRACKING, dtype=np.int64)
        for state, holds in ((LOST, self._track.lost), (REINITIALISED, self._track.reinitialised)):
            if holds is not None:
                states[holds] = state
        return states


# 3D view


AXIS_MM = 60.0
"""Length of the axes of a rigid subject."""


def scene(
    evaluation: Evaluation, table: RowTable, limit: int, wanted_ns: Sequence[int]
) -> dict[str, Any] | None:
    """Return the data of the 3D view, or None if the result has neither points nor poses.

    Args:
        evaluation: the evaluation.
        table: frame table; the shown frames are added.
        limit: approximate number of frames to show.
        wanted_ns: stamps of frames that must be shown.
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
    """Whether axes are drawn: for rigid subjects, and for tracks without points."""
    known = track.position is not None and track.quaternion is not None
    return known and (kind_of(track.subject).rigid or track.points is None)


def _estimate(track: Track, rows: IntArray) -> FloatArray:
    """Return the drawn points of the estimate, (R, D, 3): points, then origin and ends of the axes."""
    parts = [] if track.points is None else [track.points[rows]]
    if _has_axes(track):
        assert track.position is not None
        assert track.quaternion is not None
        parts.append(_axes(track.position[rows], track.quaternion[rows]))
    return np.concatenate(parts, axis=1)


def _truth(evaluation: Evaluation, rows: IntArray) -> FloatArray | None:
    """Return the drawn points of the ground truth, NaN if unknown; None if all are unknown."""
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
    """Return origin and ends of the axes of poses, (R, 4, 3)."""
    ends = position[:, None] + rotations.rotate(quaternion[:, None], AXIS_MM * np.eye(3))
    return np.concatenate([position[:, None], ends], axis=1)


def _rows(evaluation: Evaluation, limit: int, wanted_ns: Sequence[int]) -> tuple[IntArray, int]:
    """Return the rows to show: every k-th, the wanted ones, and the maximum of each error; and k."""
    stamps = evaluation.track.stamp_ns
    step = step_for(len(stamps), limit)
    worst = [
        int(evaluation.series_stamp_ns[np.argmax(np.where(np.isfinite(values), values, -np.inf))])
        for name, values in evaluation.series.items()
        if name in KINDS[evaluation.subject].readings and np.isfinite(values).any()
    ]
    # Picture stamps can be those of the frames, which differ slightly from the estimates; clipped below.
    wanted = np.searchsorted(stamps, np.array([*wanted_ns, *worst], dtype=np.int64))
    rows = np.concatenate([np.arange(0, len(stamps), step), [len(stamps) - 1], wanted])
    return np.unique(np.clip(rows, 0, len(stamps) - 1)).astype(np.int64), step


def _edges(parents: tuple[int, ...]) -> list[list[int]]:
    return [[parent, child] for child, parent in enumerate(parents) if parent >= 0]


def _readings(evaluation: Evaluation, rows: IntArray) -> list[dict[str, Any]]:
    """Return the per-frame errors of the shown frames."""
    found: list[dict[str, Any]] = []
    at = np.searchsorted(evaluation.track.stamp_ns, evaluation.series_stamp_ns)
    for name in KINDS[evaluation.subject].readings:
        if name in evaluation.series:
            values = np.full(len(evaluation.track), np.nan)
            values[at] = evaluation.series[name]
            label, unit = label_and_unit(name)
            found.append({"label": label, "unit": unit, "value": packed(values[rows], "f4")})
    return found
