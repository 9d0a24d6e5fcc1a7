"""What a result tells without truth: about its track, and about its run."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.metrics.measures import Measures
from posetrack_cli.evaluation.track import Track
from posetrack_cli.recording.timeline import GAP_FACTOR
from posetrack_cli.units import NS_PER_S

NO_TIMINGS = "the run recorded no timings; its option --timings does"
EMPTY = "the result holds no estimate"
NOT_COUNTED = "the result does not say how many poses were evaluated"
NO_WEIGHTS = "the tracker has no weighted particles"


def consistency_metrics(measures: Measures, track: Track) -> None:
    """Add the metrics of a track that need nothing but the track; what it does not allow is left out.

    - ``cost_mm``: over the frames that have a cost; ``confidence``: over all.
    - ``jitter_mm``: see ``jitter``; needs three frames in a row.
    - ``gaps``: intervals longer than ``GAP_FACTOR`` medians, as ``posetrack info`` counts them;
      ``largest_gap_s``: the longest interval. Both need two frames.
    - ``status_changes``: how often a frame's status differs from that of the frame before.
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
    """Return how much points shake from frame to frame, (N,) mm; NaN next to a gap and at the ends.

    A point's deviation from the straight line between its places one frame before (stamp t-) and one
    after (t+), scaled so that white noise of sd s per axis on a motion of constant velocity gives 3 s^2 for
    its mean square::

        |p - a p- - b p+| / sqrt(1 + a^2 + b^2),   a = (t+ - t) / (t+ - t-),   b = 1 - a

    With equal intervals that is |p- - 2 p + p+| / sqrt(6). Mean over the points, or of a track without points
    its position. An acceleration adds |acceleration| dt^2 / sqrt(6): 0.5 mm at 1 m/s^2 and 30 Hz.

    Returns:
        None for a track with neither.
    """
    points = track.position[:, None] if track.points is None and track.position is not None else track.points
    if points is None:
        return None
    whole = ~_gaps(track)
    first = np.flatnonzero(whole[:-1] & whole[1:])  # of three frames with no gap between them
    before, now, after = (track.stamp_ns[first + k] for k in range(3))
    a = (after - now) / (after - before)
    scale = 1.0 / np.sqrt(1.0 + a**2 + (1.0 - a) ** 2)
    total = np.zeros(len(first))
    for point in range(points.shape[1]):  # one at a time: a long track's points are most of its memory
        p, a_ = points[:, point], a[:, None]
        deviation = p[first + 1] - a_ * p[first] - (1.0 - a_) * p[first + 2]
        total += scale * np.linalg.norm(deviation, axis=1)
    mean: FloatArray = np.full(len(track), np.nan)
    mean[first + 1] = total / points.shape[1]
    return mean


def _gaps(track: Track) -> BoolArray:
    """Return which intervals (N - 1,) lack at least one frame."""
    intervals = np.diff(track.stamp_ns)
    if not intervals.size:
        return np.zeros(0, dtype=np.bool_)
    gaps: BoolArray = intervals > GAP_FACTOR * np.median(intervals)
    return gaps


def run_metrics(measures: Measures, track: Track, run: Mapping[str, str]) -> None:
    """Add time per frame, frames/s, evaluations, effective sample size, resampling rate and particles."""
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
        measures.lack("the run record names no number of particles", "particles")
    else:
        measures.metrics["particles"] = float(particles)


def run_series(track: Track) -> dict[str, FloatArray]:
    """Return what a run says about each of its frames, (N,) by metric."""
    columns = {
        "cost_mm": track.cost,
        "confidence": track.confidence,
        "ms_per_frame": track.milliseconds,
        "ess": track.effective_sample_size,
        "evaluations": track.evaluations,
    }
    return {name: values for name, values in columns.items() if values is not None}


def _known(measures: Measures, name: str, values: FloatArray | None, nothing: str) -> None:
    """Summarise the values that are known; where there are none, say why."""
    values = np.empty(0) if values is None else values
    measures.summarise(name, values[np.isfinite(values)], nothing)


def _timings(measures: Measures, track: Track) -> None:
    """Time of the frames that were timed; frames per second is their number over their time together."""
    recorded = np.empty(0) if track.milliseconds is None else track.milliseconds
    timed = recorded[np.isfinite(recorded)]
    if not timed.size:
        return measures.lack(NO_TIMINGS if len(track) else EMPTY, "ms_per_frame", "frames_per_s")
    measures.summarise("ms_per_frame", timed)
    if len(timed) < len(recorded):
        measures.notes.append(f"times of the {len(timed)} of {len(recorded)} frames that were timed")
    total_s = 1e-3 * float(timed.sum())
    if total_s > 0.0:
        measures.metrics["frames_per_s"] = len(timed) / total_s
    else:
        measures.lack("the recorded times are 0", "frames_per_s")


def particle_count(run: Mapping[str, str]) -> int | None:
    """Return the size of the filter or the swarm in a run record's configuration; None where it has none."""
    try:
        configuration = json.loads(run["configuration"])
        if "particles" in configuration:  # a head's
            return int(configuration["particles"]["count"])
        swarm = configuration["filter"].get("kind") == "pso"
        return int(configuration["pso" if swarm else "filter"]["particles"])
    except (KeyError, ValueError, TypeError, AttributeError, OverflowError):
        return None
