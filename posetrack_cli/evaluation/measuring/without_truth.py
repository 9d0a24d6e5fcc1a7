"""Metrics without ground truth, and confidence metrics."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.measuring import honesty
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, rows_of
from posetrack_cli.evaluation.measuring.subjects.kind import SubjectKind
from posetrack_cli.evaluation.reading.tracks import Track
from posetrack_cli.recording.timeline import GAP_FACTOR
from posetrack_cli.units import NS_PER_S

# Self-consistency and run metrics


NO_TIMINGS = "the run stored no timings; track with --timings"
EMPTY = "the result has no estimates"
NOT_COUNTED = "the result does not store the number of evaluated poses"
NO_WEIGHTS = "the tracker does not use weighted particles"


def consistency_metrics(measures: Measures, track: Track) -> None:
    """Add the metrics that need only the track; those that cannot be computed are left out.

    - ``cost_mm``: over the frames with a cost; ``confidence``: over all frames.
    - ``jitter_mm``: see ``jitter``; requires three consecutive frames.
    - ``gaps``: number of intervals longer than ``GAP_FACTOR`` times the median, as in ``posetrack info``;
      ``largest_gap_s``: the longest interval. Both require two frames.
    - ``status_changes``: number of frames whose status differs from the previous frame.
    """
    metrics = measures.metrics
    shaking = jitter(track)
    if shaking is not None:
        measures.track_series["jitter_mm"] = shaking
    samples = {"cost_mm": track.cost, "confidence": track.confidence, "jitter_mm": shaking}
    for name, values in samples.items():
        known = None if values is None else values[~np.isnan(values)]
        if known is not None and known.size:
            measures.summarise(name, known)
    if len(track) >= 2:
        metrics["gaps"] = float(_gaps(track).sum())
        metrics["largest_gap_s"] = float(np.diff(track.stamp_ns).max()) / NS_PER_S
    if len(track) and track.lost is not None and track.reinitialised is not None:
        status = track.lost.astype(np.int64) + 2 * track.reinitialised
        metrics["status_changes"] = float((np.diff(status) != 0).sum())


def jitter(track: Track) -> FloatArray | None:
    """Return the frame-to-frame jitter (N,), mm; NaN next to gaps and at both ends.

    Deviation of a point from the linear interpolation between the previous (stamp t-) and next frame (t+),
    scaled so that white noise of sd s per axis on a motion of constant velocity has a mean square of 3 s^2::

        |p - a p- - b p+| / sqrt(1 + a^2 + b^2),   a = (t+ - t) / (t+ - t-),   b = 1 - a

    With equal intervals this is |p- - 2 p + p+| / sqrt(6). Mean over the points, or the position for tracks
    without points. An acceleration adds |acceleration| dt^2 / sqrt(6): 0.5 mm at 1 m/s^2 and 30 Hz.

    Returns:
        None for a track without points and positions.
    """
    points = track.position[:, None] if track.points is None and track.position is not None else track.points
    if points is None:
        return None
    whole = ~_gaps(track)
    first = np.flatnonzero(whole[:-1] & whole[1:])  # first of three frames without a gap
    before, now, after = (track.stamp_ns[first + k] for k in range(3))
    a = (after - now) / (after - before)
    scale = 1.0 / np.sqrt(1.0 + a**2 + (1.0 - a) ** 2)
    total = np.zeros(len(first))
    for point in range(points.shape[1]):  # one at a time, as the points dominate the memory of a long track
        p, a_ = points[:, point], a[:, None]
        deviation = p[first + 1] - a_ * p[first] - (1.0 - a_) * p[first + 2]
        total += scale * np.linalg.norm(deviation, axis=1)
    mean: FloatArray = np.full(len(track), np.nan)
    mean[first + 1] = total / points.shape[1]
    return mean


def _gaps(track: Track) -> BoolArray:
    """Return the mask (N - 1,) of intervals with at least one missing frame."""
    intervals = np.diff(track.stamp_ns)
    if not intervals.size:
        return np.zeros(0, dtype=np.bool_)
    gaps: BoolArray = intervals > GAP_FACTOR * np.median(intervals)
    return gaps


def run_metrics(measures: Measures, track: Track, run: Mapping[str, str]) -> None:
    """Add processing time, evaluations, effective sample size, resampling rate and number of particles."""
    _timings(measures, track)
    _known(measures, "evaluations", track.evaluations, NOT_COUNTED if len(track) else EMPTY)
    _known(measures, "ess", track.effective_sample_size, NO_WEIGHTS if len(track) else EMPTY)
    resampled = np.empty(0) if track.resampled is None else track.resampled
    if resampled.size:
        measures.metrics["resampling_rate"] = float(resampled.mean())
    else:
        measures.lack(EMPTY, "resampling_rate")
    particles = particle_count(run)
    if particles is None:
        measures.lack("the run record has no number of particles", "particles")
    else:
        measures.metrics["particles"] = float(particles)


def run_series(track: Track) -> dict[str, FloatArray]:
    """Return the per-frame values stored by the run, (N,) by metric."""
    columns = {
        "cost_mm": track.cost,
        "confidence": track.confidence,
        "ms_per_frame": track.milliseconds,
        "ess": track.effective_sample_size,
        "evaluations": track.evaluations,
    }
    return {name: values for name, values in columns.items() if values is not None}


def _known(measures: Measures, name: str, values: FloatArray | None, nothing: str) -> None:
    """Summarise the finite values; record the reason ``nothing`` if there are none."""
    values = np.empty(0) if values is None else values
    measures.summarise(name, values[np.isfinite(values)], nothing)


def _timings(measures: Measures, track: Track) -> None:
    """Add processing time and frame rate over the frames with a stored time."""
    # NaN marks frames without a stored time.
    recorded = np.empty(0) if track.milliseconds is None else track.milliseconds
    timed = recorded[np.isfinite(recorded)]
    if not timed.size:
        return measures.lack(NO_TIMINGS if len(track) else EMPTY, "ms_per_frame", "frames_per_s")
    measures.summarise("ms_per_frame", timed)
    if len(timed) < len(recorded):
        measures.notes.append(f"timings cover {len(timed)} of {len(recorded)} frames")
    total_s = 1e-3 * float(timed.sum())
    if total_s > 0.0:
        measures.metrics["frames_per_s"] = len(timed) / total_s
    else:
        measures.lack("the recorded times are 0", "frames_per_s")


def particle_count(run: Mapping[str, str]) -> int | None:
    """Return the number of particles of the filter or swarm from a run record; None if not stored."""
    try:
        configuration = json.loads(run["configuration"])
        if "particles" in configuration:  # head tracker
            return int(configuration["particles"]["count"])
        swarm = configuration["filter"].get("kind") == "pso"
        return int(configuration["pso" if swarm else "filter"]["particles"])
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError):  # run records are untrusted
        return None


# Confidence and status against ground truth


WRONG, FAR_TRACKED, RIGHT_LOST = "frames_wrong", "frames_far_tracked", "frames_right_lost"
ROC_AREA = "confidence_roc_area"
BRIER, CALIBRATION = "confidence_brier_score", "confidence_calibration_error"
OF_CONFIDENCE = (ROC_AREA, BRIER, CALIBRATION)
HONESTY = (WRONG, FAR_TRACKED, RIGHT_LOST, *OF_CONFIDENCE)
"""Metrics of the group ``honesty``."""
ALL_WRONG, ALL_RIGHT = "no frame is correct", "no frame is wrong"
NO_CONFIDENCE = "the result has no confidence"


def judged_frames(measures: Measures, matched: Matched, kind: SubjectKind) -> JudgedFrames | None:
    """Judge the matched frames by the error limits of the kind of subject.

    Only frames with all errors known are judged. Metrics that the ground truth does not support are ignored,
    except the first one of ``kind.right``: without it, the reason is recorded and None is returned.

    Args:
        measures: collector; already has the per-frame errors.
        matched: matched frames.
        kind: kind of subject.
    """
    first = next(iter(kind.right), None)
    if first is None:
        return None
    if first not in measures.series:
        reason = measures.absent.get(first, measures.nothing)
        measures.lack(reason, *HONESTY)
        return None
    right, far = (_measured(measures, limits) for limits in (kind.right, kind.far))
    errors = [measures.series[name] for name in dict.fromkeys((*right, *far))]
    known = np.logical_and.reduce([np.isfinite(one) for one in errors])
    estimate, rows = matched.estimate, matched.pairs.estimate
    unstated = np.full(len(rows), np.nan)
    lost = np.zeros(len(rows), dtype=np.bool_) if estimate.lost is None else rows_of(estimate.lost, rows)
    confidence = unstated if estimate.confidence is None else rows_of(estimate.confidence, rows)
    return JudgedFrames(
        confidence=confidence[known],
        right=~_beyond_any(measures, right)[known],
        far=_beyond_any(measures, far)[known],
        lost=lost[known],
        right_if=kind.in_words(right, "at most", " and "),
        far_if=kind.in_words(far, "above", " or "),
    )


def _measured(measures: Measures, limits: Mapping[str, float]) -> dict[str, float]:
    """Return the limits of the available errors."""
    return {name: limit for name, limit in limits.items() if name in measures.series}


def _beyond_any(measures: Measures, limits: Mapping[str, float]) -> BoolArray:
    """Return the mask (M,) of frames in which some error exceeds its limit."""
    beyond: BoolArray = np.logical_or.reduce([measures.series[name] > most for name, most in limits.items()])
    return beyond


def honesty_metrics(measures: Measures, judged: JudgedFrames) -> None:
    """Add the metrics that compare confidence and status with correctness; see
    ``evaluation.measuring.honesty``.

    Args:
        measures: collector.
        judged: judged frames of one track or of a pool.
    """
    measures.share(WRONG, ~judged.right)
    measures.share(FAR_TRACKED, judged.far & ~judged.lost)
    if judged.right.any():
        measures.share(RIGHT_LOST, judged.lost[judged.right])
    else:
        measures.lack(ALL_WRONG if len(judged.right) else measures.nothing, RIGHT_LOST)
    confidence, right = judged.scored
    if not len(right):
        return measures.lack(NO_CONFIDENCE if len(judged.right) else measures.nothing, *OF_CONFIDENCE)
    measures.metrics[BRIER] = honesty.brier_score(confidence, right)
    measures.metrics[CALIBRATION] = honesty.calibration_error(honesty.reliability(confidence, right))
    if right.all() or not right.any():
        return measures.lack(ALL_RIGHT if right.all() else ALL_WRONG, ROC_AREA)
    measures.metrics[ROC_AREA] = honesty.roc_area(confidence, right)
