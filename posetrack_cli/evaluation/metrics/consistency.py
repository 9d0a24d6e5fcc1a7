"""What a track tells about itself, without truth."""

from __future__ import annotations

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray, IntArray
from posetrack_cli.evaluation.evaluation import Value
from posetrack_cli.evaluation.statistics import statistics
from posetrack_cli.evaluation.track import Track
from posetrack_cli.recording.timeline import GAP_FACTOR
from posetrack_cli.units import NS_PER_S


def consistency_metrics(track: Track) -> dict[str, Value]:
    """Return the metrics of a track that need nothing but the track; what it does not allow is left out.

    - ``cost_mm``: over the frames that have a cost; ``confidence``: over all.
    - ``jitter_mm``: see ``jitter``; needs three frames in a row.
    - ``gaps``: intervals longer than ``GAP_FACTOR`` medians, as ``posetrack info`` counts them;
      ``largest_gap_s``: the longest interval. Both need two frames.
    - ``status_changes``: how often a frame's status differs from that of the frame before.
    """
    metrics: dict[str, Value] = {}
    samples = {"cost_mm": track.cost, "confidence": track.confidence, "jitter_mm": jitter(track)}
    for name, values in samples.items():
        known = None if values is None else values[~np.isnan(values)]
        if known is not None and known.size:
            metrics[name] = statistics(known)
    if len(track) >= 2:
        metrics["gaps"] = float(_gaps(track).sum())
        metrics["largest_gap_s"] = float(np.diff(track.stamp_ns).max()) / NS_PER_S
    if len(track) and track.lost is not None and track.reinitialised is not None:
        status = track.lost.astype(np.int64) + 2 * track.reinitialised
        metrics["status_changes"] = float((np.diff(status) != 0).sum())
    return metrics


def jitter(track: Track) -> FloatArray | None:
    """Return how much points shake from frame to frame, (J,) mm, one value per three frames without a gap.

    A point's deviation from the straight line between its places one frame before (stamp t-) and one
    after (t+), scaled so that white noise of sd s per axis on a motion of constant velocity gives 3 s^2 for
    its mean square::

        |p - a p- - b p+| / sqrt(1 + a^2 + b^2),   a = (t+ - t) / (t+ - t-),   b = 1 - a

    With equal intervals that is |p- - 2 p + p+| / sqrt(6). Mean over the points, or of a track without points
    its position. An acceleration adds |acceleration| dt^2 / sqrt(6): 0.5 mm at 1 m/s^2 and 30 Hz.

    Returns:
        None for a track with neither; empty for fewer than three frames in a row.
    """
    points = track.position[:, None] if track.points is None and track.position is not None else track.points
    if points is None:
        return None
    first = _first_of_three(track)
    before, now, after = (track.stamp_ns[first + k] for k in range(3))
    a = (after - now) / (after - before)
    scale = 1.0 / np.sqrt(1.0 + a**2 + (1.0 - a) ** 2)
    total = np.zeros(len(first))
    for point in range(points.shape[1]):  # one at a time: a long track's points are most of its memory
        p, a_ = points[:, point], a[:, None]
        deviation = p[first + 1] - a_ * p[first] - (1.0 - a_) * p[first + 2]
        total += scale * np.linalg.norm(deviation, axis=1)
    mean: FloatArray = total / points.shape[1]
    return mean


def _gaps(track: Track) -> BoolArray:
    """Return which intervals (N - 1,) lack at least one frame."""
    intervals = np.diff(track.stamp_ns)
    if not intervals.size:
        return np.zeros(0, dtype=np.bool_)
    gaps: BoolArray = intervals > GAP_FACTOR * np.median(intervals)
    return gaps


def _first_of_three(track: Track) -> IntArray:
    """Return the rows that begin three frames with no gap between them."""
    whole = ~_gaps(track)
    return np.flatnonzero(whole[:-1] & whole[1:])
