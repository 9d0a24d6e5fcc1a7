"""What a result tells of itself: figures without truth, agreement with images, worth of its confidence."""

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
from posetrack_cli.results.channels import FILTERED
from posetrack_cli.results.reader import Result
from posetrack_cli.units import NS_PER_S

# What a result tells without truth: about its track, and about its run


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


# How well a hand result agrees with the images it was made from: no truth needed, and no truth either.
#
# The hand's pixels are told from the rest of an image around the estimate itself
# (``hand.segmentation``), so the figures are circular: they say that an estimate explains what is
# near it, not that it is right. A hand mirrored or swapped in its fingers can score well; one that has left
# the hand scores badly.


MESH_LEVEL = "fine"
WINDOW_MM = 320.0
"""A hand of scale 1 within ``reach_mm`` of its middle, whichever way it points, and some room."""
TILE_PX = 160
NO_CLAMP_MM = 1e6
"""Segmentation bounds the differences already."""


class HandConsistency:
    """Compares hands with images, one by one; the measure is the same for every run.

    Window and segmentation are the defaults, not the run's: results of different configurations are
    measured alike. Only the hand's side and size are the run's.

    Args:
        device: draws the hands.
        hand: bones and skin.
        camera: of the images; lens distortion is taken out.
    """

    def __init__(self, device: RenderingDevice, hand: HandModel, camera: Camera) -> None:
        self._anatomy, self._camera, self._sampler = hand.anatomy, camera, PixelSampler(camera)
        self._window = ObservationSettings(window_mm=WINDOW_MM * hand.anatomy.scale, tile_px=TILE_PX)
        mesh = hand.skin(MESH_LEVEL)
        self._renderer = device.depth_renderer(mesh, (TILE_PX, TILE_PX), 1)

    def compare(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> tuple[float, float]:
        """Return residual, mm (NaN where nothing is both), and overlap of a hand with a frame.

        Args:
            pose: (22,).
            frame: the image.
            thumb: (2,) its inner angles.
        """
        sums = self.sums(pose, frame, thumb)
        return residual_mm(sums), region_overlap(sums)

    def sums(self, pose: FloatArray, frame: Frame, thumb: FloatArray = NO_THUMB) -> TileSums:
        """Sums over the pixels of the window around a pose (22,) with inner angles of its thumb (2,)."""
        hand = PredictedHand.of(self._anatomy, pose, thumb)
        window = window_around(hand.joints, self._camera, self._window)
        observed = segment(frame.depth, self._sampler, window, self._camera, hand).observation
        transforms = skinning_transforms(self._anatomy, pose[None], thumb)
        return self._renderer.sums(transforms, self._camera, window, Comparison(observed.image, NO_CLAMP_MM))


def residual_mm(sums: TileSums) -> float:
    """Mean |rendered - observed| over the pixels of one tile that are both rendered and observed hand, mm.

    NaN where there is no such pixel; the overlap, 0, then says what is wrong.
    """
    both = float(sums.both[0])
    return float(sums.error[0]) / both if both else float("nan")


def region_overlap(sums: TileSums) -> float:
    """Intersection over union of rendered and observed hand: |r and o| / |r or o|, 0 to 1.

    Rendered pixels without a reading count on neither side: at a hand's edge most readings are missing, and
    what lies beyond the wrist is no hand. 0 where there is nothing at all.
    """
    both = float(sums.both[0])
    union = sums.observed + float(sums.rendered_only[0])
    return both / union if union else 0.0


def image_consistency(
    result: Result, recording: Recording, device: int | None = None, which: str = FILTERED
) -> dict[str, FloatArray]:
    """Metrics ``residual_mm`` and ``region_overlap`` of every frame (N,), lost ones included, NaN for none.

    Both are circular: the observed hand is told from the rest around the estimate. A frame that the recording
    does not give has neither; ``residual_mm`` has no value where estimate and observed hand share no pixel,
    and ``region_overlap`` is 0 there.

    Args:
        result: of a hand.
        recording: what it was made from (``search_recording``); every frame is read once.
        device: EGL device index, None for the default, or the processor without OpenGL.
        which: of its tracks.

    Returns:
        Nothing where the recording gives none of the result's frames, or the result has none.

    Raises:
        ResultError: the result is of another subject.
        UsageError: the images are not of the size that was tracked.
        RenderingError: nothing can be rendered here.
    """
    hand, track = hand_of(result), track_of_result(result, "", which)
    if not len(track):
        return {}
    (camera,) = cameras_of(result, recording)
    with closing(open_usual_device(device)) as drawing:
        residual, overlap = _compared(track, recording, HandConsistency(drawing, hand, camera)).T
    return {} if np.isnan(overlap).all() else {"residual_mm": residual, "region_overlap": overlap}


def _compared(track: Track, recording: Recording, measure: HandConsistency) -> FloatArray:
    """Residual and overlap (N, 2) of every frame, NaN where the recording does not give it."""
    compared = np.full((len(track), 2), np.nan)
    if track.position is None or track.quaternion is None or track.shape is None:
        return compared
    poses = np.hstack([track.position, track.quaternion, track.shape])
    thumbs = thumbs_of(track.numbers, len(track))
    for row, frame in matched_frames(recording, track.stamp_ns, track.frame_index, LossLog()):
        compared[row] = measure.compare(poses[row], frame, thumbs[row])
    return compared


# Metrics of what a track says of itself against truth: by confidence, and by its status


WRONG, FAR_TRACKED, RIGHT_LOST = "frames_wrong", "frames_far_tracked", "frames_right_lost"
ROC_AREA = "confidence_roc_area"
BRIER, CALIBRATION = "confidence_brier_score", "confidence_calibration_error"
OF_CONFIDENCE = (ROC_AREA, BRIER, CALIBRATION)
HONESTY = (WRONG, FAR_TRACKED, RIGHT_LOST, *OF_CONFIDENCE)
"""All that is measured here."""
ALL_WRONG, ALL_RIGHT = "no frame is right", "no frame is wrong"
NO_CONFIDENCE = "the result states no confidence"


def judged_frames(measures: Measures, matched: Matched, kind: SubjectKind) -> JudgedFrames | None:
    """Return which of the matched frames are right and which far off, by their errors as they are measured.

    A frame counts whose errors are known. Errors that the truth does not allow do not decide, but the first
    that the kind names must be there; else there is nothing to judge by, which is None, and why is kept.

    Args:
        measures: has the errors by frame already, and takes the reason.
        matched: the frames.
        kind: of the subject: what is right.
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
    """The limits of those errors that there are."""
    return {name: limit for name, limit in limits.items() if name in measures.series}


def _beyond_any(measures: Measures, limits: Mapping[str, float]) -> BoolArray:
    """In which frames (M,) an error is above its limit."""
    beyond: BoolArray = np.logical_or.reduce([measures.series[name] > most for name, most in limits.items()])
    return beyond


def honesty_metrics(measures: Measures, judged: JudgedFrames) -> None:
    """Add how well confidence and status agree with what is right; see ``evaluation.measuring.honesty``.

    Args:
        measures: where to.
        judged: the frames, of one track or of several pooled.
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
