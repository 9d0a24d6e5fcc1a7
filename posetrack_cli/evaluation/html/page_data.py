"""What the page's plots show: evaluations reduced to it, on one time axis."""

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

# An evaluation reduced to what the page's plots show: small enough to embed, with every peak kept


@dataclass(frozen=True)
class Budget:
    """How much of each result a page holds, so that several results make no page too large to open.

    Attributes:
        quantity_points: points of each line of the plot over time.
        component_points: points of each component of the trajectories.
        scene_frames: frames of the 3-D view.
    """

    quantity_points: int
    component_points: int
    scene_frames: int


def budget_for(results: int) -> Budget:
    """Return the budget of each of so many results."""
    share = max(1, results)
    return Budget(max(300, 6000 // share), max(100, 2500 // share), max(100, 5000 // share))


def page_data(
    evaluations: Sequence[Evaluation], pictures: Mapping[str, Sequence[Picture]], pools: Sequence[Pool] = ()
) -> dict[str, Any]:
    """Return everything that the page's scripts need, ready for JSON (see ``packing.json_text``).

    Arrays are packed; a line or scene names its frames by places in its result's table of kept frames.
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
        "pools": [{"name": pool.name, "honesty": _honesty(pool.judged)} for pool in pools if pool.says_more],
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
    """Per-frame values by metric, those of the series and those that the track itself tells."""
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
            continue
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
    """The reliability of confidence, bins without frames left out, and its ROC curve."""
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
    """The error of each joint or point."""
    metric = KINDS[evaluation.subject].point_metric
    found = []
    for name in evaluation.track.point_names:
        value = evaluation.metrics.get(f"{metric}.{name}")
        if isinstance(value, Statistics) and value.count:
            found.append({"label": readable(name), "mean": value.mean, "p95": value.p95})
    return found


# The page's time, and which frames of a result it knows


TICK_NS = 100_000
"""0.1 ms: far below a frame, and 31 bits of it are 59 hours."""

MOST_TICKS = 2**31 - 1
MOST_SPANS = 1000
"""More spans than that cannot be told apart in a plot; those nearest each other are merged."""


@dataclass(frozen=True)
class Timebase:
    """What one result's times count from.

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
        """Return stamps as seconds since the origin, to whole ticks: the very numbers of the scripts."""
        return self.ticks(stamp_ns).astype(np.float64) * self.tick_s


def timebases(tracks: Sequence[Track]) -> tuple[list[Timebase], bool]:
    """Return each track's time base, and whether all count from the same origin.

    Tracks whose spans all have some time in common are shown over one time that begins with the first of
    them; otherwise each counts from its own first frame.
    """
    filled = [track.stamp_ns for track in tracks if len(track)]
    if not filled:
        return [Timebase(0, TICK_NS) for _ in tracks], True
    first, last = [int(stamps[0]) for stamps in filled], [int(stamps[-1]) for stamps in filled]
    shared = max(first) <= min(last)
    longest = max(last) - min(first) if shared else max(b - a for a, b in zip(first, last, strict=True))
    tick_ns = max(TICK_NS, -(-longest // MOST_TICKS))
    starts = [int(track.stamp_ns[0]) if len(track) and not shared else min(first) for track in tracks]
    return [Timebase(start, tick_ns) for start in starts], shared


def gap_spans(stamp_ns: IntArray) -> IntArray:
    """Return (G, 2) stamps before and after each gap, the longest ``MOST_SPANS`` of them, in order.

    Gaps are what the metric ``gaps`` counts: intervals of more than ``GAP_FACTOR`` usual ones.
    """
    steps = np.diff(stamp_ns)
    if not len(steps):
        return np.empty((0, 2), dtype=np.int64)
    gaps = np.flatnonzero(steps > GAP_FACTOR * np.median(steps))
    if len(gaps) > MOST_SPANS:
        gaps = np.sort(gaps[np.argsort(-steps[gaps], kind="stable")[:MOST_SPANS]])
    return np.stack([stamp_ns[gaps], stamp_ns[gaps + 1]], axis=1)


def state_spans(stamp_ns: IntArray, holds: BoolArray) -> IntArray:
    """Return (S, 2) stamps of the first and last frame of each run of frames where ``holds`` is true.

    Of more than ``MOST_SPANS`` runs, those with the shortest pauses between them are merged.
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
    """Collects rows of a track; their times, frame numbers and states are embedded once.

    ``add`` returns a placeholder that ``finish`` fills with the rows' places in the table.
    """

    def __init__(self, track: Track, timebase: Timebase) -> None:
        self._track = track
        self._timebase = timebase
        self._waiting: list[tuple[IntArray, Packed]] = []

    def add(self, rows: IntArray) -> Packed:
        """Ask for rows of the track; the returned mapping holds their places after ``finish``."""
        places: Packed = {}
        self._waiting.append((rows, places))
        return places

    def finish(self) -> dict[str, Packed]:
        """Fill every placeholder and return the table: ticks, frame numbers and states."""
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
        """Places in the recording; in the result where those are not known."""
        known = self._track.frame_index
        return np.arange(len(self._track), dtype=np.int64) if known is None else known

    def _states(self) -> IntArray:
        states = np.full(len(self._track), TRACKING, dtype=np.int64)
        for state, holds in ((LOST, self._track.lost), (REINITIALISED, self._track.reinitialised)):
            if holds is not None:
                states[holds] = state
        return states


# The 3-D view's data: points and axes of estimate and truth at every k-th frame


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
