"""Metrics without ground truth, agreement with depth images, and confidence metrics."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import closing

import numpy as np

from posetrack_cli.arrays import BoolArray, FloatArray
from posetrack_cli.evaluation.measuring import honesty
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, rows_of
from posetrack_cli.evaluation.measuring.subjects.kind import SubjectKind
from posetrack_cli.evaluation.reading.recording_of import cameras_of, hand_of
from posetrack_cli.evaluation.reading.tracks import Track, matched_frames, track_of_result
from posetrack_cli.geometry.camera import Camera
from posetrack_cli.hand.config import ObservationSettings
from posetrack_cli.hand.fit.skeleton import NO_THUMB, thumbs_of
from posetrack_cli.hand.model.hand import HandModel
from posetrack_cli.hand.model.kinematics import skinning_transforms
from posetrack_cli.hand.observe.observation import PixelSampler, window_around
from posetrack_cli.hand.observe.prediction import PredictedHand
from posetrack_cli.hand.observe.segmentation import segment
from posetrack_cli.losses import LossLog
from posetrack_cli.recording.base import Frame
from posetrack_cli.recording.recording import Recording
from posetrack_cli.recording.timeline import GAP_FACTOR
from posetrack_cli.rendering.devices import open_usual_device
from posetrack_cli.rendering.port import Comparison, RenderingDevice, TileSums
from posetrack_cli.results.reader import Result
from posetrack_cli.results.topics import FILTERED
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


# Agreement of hand results with the depth images.
#
# The observed hand is segmented around the estimate (``hand.observe.segmentation``), so these metrics are
# circular: they show that the estimate explains the nearby depth, not that it is correct. A mirrored hand or
# swapped fingers can score well; an estimate that has left the hand scores badly.


MESH_LEVEL = "fine"
WINDOW_MM = 320.0
"""Size of the image window at scale 1: fits the hand in any orientation, with a margin."""
TILE_PX = 160
NO_CLAMP_MM = 1e6
"""No clamping of depth differences, as segmentation already bounds them."""


class HandConsistency:
    """Compares hand poses with depth images.

    Uses the default window and segmentation settings rather than those of the run, so that results of
    different configurations are comparable. Only side and size of the hand are taken from the run.

    Args:
        device: rendering device.
        hand: hand model.
        camera: camera of the images; lens distortion is compensated.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera) -> None:
        self._anatomy, self._camera, self._sampler = hand.anatomy, camera, PixelSampler(camera)
        self._window = ObservationSettings(window_mm=WINDOW_MM * hand.anatomy.scale, tile_px=TILE_PX)
        mesh = hand.skin(MESH_LEVEL)
        self._renderer = device.depth_renderer(mesh, (TILE_PX, TILE_PX), 1)

    def compare(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> tuple[float, float]:
        """Return ``residual_mm`` (NaN without overlap) and ``region_overlap`` of a hand in a frame.

        Args:
            pose: (22,) hand pose.
            frame: frame with the depth image.
            thumb: (2,) inner angles of the thumb.
        """
        sums = self.sums(pose, frame, thumb)
        return residual_mm(sums), region_overlap(sums)

    def sums(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> TileSums:
        """Return the comparison sums over the pixels of the window around a pose; see ``compare``."""
        hand = PredictedHand.of(self._anatomy, pose, thumb)
        window = window_around(hand.joints, self._camera, self._window)
        observed = segment(frame.depth, self._sampler, window, self._camera, hand).observation
        transforms = skinning_transforms(self._anatomy, pose[None], thumb)
        return self._renderer.sums(transforms, self._camera, window, Comparison(observed.image, NO_CLAMP_MM))


def residual_mm(sums: TileSums) -> float:
    """Return the mean |rendered - observed|, mm, over the pixels of both the rendered and the observed hand.

    NaN without such a pixel; the overlap is 0 then.
    """
    both = float(sums.both[0])
    return float(sums.error[0]) / both if both else float("nan")


def region_overlap(sums: TileSums) -> float:
    """Return the intersection over union of rendered and observed hand, |r and o| / |r or o|, 0 to 1.

    Rendered pixels without a depth reading are ignored, as most readings at the edge of a hand are missing.
    0 if there are no pixels.
    """
    both = float(sums.both[0])
    union = sums.observed + float(sums.rendered_only[0])
    return both / union if union else 0.0


def image_consistency(
    result: Result, recording: Recording, device: int | None = None, which: str = FILTERED
) -> dict[str, FloatArray]:
    """Return ``residual_mm`` and ``region_overlap`` of all frames (N,), including lost ones.

    Both are NaN in frames that the recording does not have. Without common pixels, ``residual_mm`` is NaN and
    ``region_overlap`` is 0.

    Args:
        result: result of a hand.
        recording: recording of the result (``search_recording``); each frame is read once.
        device: EGL device index; None for the default device, or the CPU without OpenGL.
        which: name of the track.

    Returns:
        An empty dictionary if the result is empty or the recording has none of its frames.

    Raises:
        ResultError: the result is of another subject.
        UsageError: the image size differs from that of the run.
        RenderingError: no renderer is available.
    """
    hand, track = hand_of(result), track_of_result(result, "", which)
    if not len(track):
        return {}
    (camera,) = cameras_of(result, recording)
    with closing(open_usual_device(device)) as drawing:
        residual, overlap = _compared(track, recording, HandConsistency(drawing, hand, camera)).T
    return {} if np.isnan(overlap).all() else {"residual_mm": residual, "region_overlap": overlap}


def _compared(track: Track, recording: Recording, measure: HandConsistency) -> FloatArray:
    """Return residual and overlap (N, 2) of all frames, NaN for frames that the recording does not have."""
    compared = np.full((len(track), 2), np.nan)
    if track.position is None or track.quaternion is None or track.shape is None:
        return compared
    poses = np.hstack([track.position, track.quaternion, track.shape])
    thumbs = thumbs_of(track.numbers, len(track))
    for row, frame in matched_frames(recording, track.stamp_ns, track.frame_index, LossLog()):
        compared[row] = measure.compare(poses[row], frame, thumbs[row])
    return compared


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
