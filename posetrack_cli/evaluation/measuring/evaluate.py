"""Evaluation of a result: load result and ground truth, associate frames, compute all metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.evaluation.measuring.catalogue import addresses, metric_of
from posetrack_cli.evaluation.measuring.evaluation import Curve, Evaluation, Value
from posetrack_cli.evaluation.measuring.face_metrics import GAZE_NAMES, face_metrics
from posetrack_cli.evaluation.measuring.face_metrics import NAMES as FACE_NAMES
from posetrack_cli.evaluation.measuring.honesty import JudgedFrames
from posetrack_cli.evaluation.measuring.measures import Matched, Measures, rows_of
from posetrack_cli.evaluation.measuring.subjects import KINDS
from posetrack_cli.evaluation.measuring.without_truth import (
    EMPTY,
    consistency_metrics,
    honesty_metrics,
    judged_frames,
    run_metrics,
    run_series,
)
from posetrack_cli.evaluation.reading.alignment import (
    NO_FRAME,
    JointOffsets,
    OffsetFrame,
    common_factor,
    remove_constant_offset,
)
from posetrack_cli.evaluation.reading.identities import Identities, Identity, identities
from posetrack_cli.evaluation.reading.tracks import (
    SINGLE_FIELDS,
    Coverage,
    Pairs,
    Track,
    associate,
    associate_frames,
    measure_coverage,
    nearest_rows,
    plain_name,
    track_fields,
    track_of_columns,
)
from posetrack_cli.evaluation.reading.truth import estimate_truth_topic, load_truth, truth_fields
from posetrack_cli.evaluation.reading.truth_tables import truth_warnings
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.results.reader import Result, read_result
from posetrack_cli.results.topics import FILTERED, SMOOTHED

Alignment: TypeAlias = Literal["none", "rigid", "rigid+points", "similarity"]

AGAINST_TRUTH = ("accuracy", "velocity", "covariance", "honesty")
LONGEST_OFFSET_S = 1e10
"""Bound on the time offset: slightly more than int64 nanoseconds can hold (292 years)."""
SMOOTHED_NOTE = "smoothed track: estimates also use later frames"
PRIOR_NOTE = "monocular: distance and size come from the face prior, as scale is not observable"
GUESS_NOTE = "uncalibrated camera: the focal length is a guess, and the distance scales with it"
NO_TRUTH = "no ground truth: the result contains none, and --truth was not given"
NO_IMAGES = "the recording has none of the result's frames"
NO_OVERLAP = "the estimate overlaps the observed hand in no frame"
NO_LANDMARKS = "requires landmarks of the face: pass them with --face-truth"
NO_EYES = "the ground truth has no gaze"
NO_RECORDING = "requires the images: pass the recording with --recording"
FALSE_TRACK = "follows no subject of the ground truth"
_ONE_TRACK = "one track and one subject"
WITHOUT_TRUTH = {
    **dict.fromkeys(("identity_switches", "false_tracks", "missed_tracks"), _ONE_TRACK),
    "residual_mm": NO_RECORDING,
    "region_overlap": NO_RECORDING,
    "cost_mm": "the run stored no costs",
    "jitter_mm": "fewer than three consecutive frames",
    "gaps": "fewer than two frames",
    "largest_gap_s": "fewer than two frames",
}
"""Reasons why these metrics have no value, if they have none."""


@dataclass(frozen=True)
class EvalOptions:
    """Options of an evaluation.

    Attributes:
        truth: ground-truth file; None uses the ground truth in the result.
        tolerance_ms: maximum difference between the stamps of an estimate and its ground truth, ms.
        time_offset_s: added to the ground-truth stamps, s.
        align: ``rigid`` removes one constant rigid offset, ``rigid+points`` also a constant offset of each
            point, ``similarity`` one scale factor and one constant rigid offset.
        recording: recording of the result, for the metrics that compare with images; None skips them.
        track: name of the track to evaluate.
        face_truth: landmarks of the dense face, CSV (``face_metrics``); None for none.
        joint_offsets: frame in which the constant offset of each hand joint is removed, see
            ``remove_joint_offsets``; None removes none.
        label: label of the subject, for a result of several.

    Raises:
        UsageError: a value is out of range, or the alignment is unknown.
    """

    truth: Path | None = None
    tolerance_ms: float = 5.0
    time_offset_s: float = 0.0
    align: Alignment = "none"
    recording: Path | None = None
    track: str = FILTERED
    joint_offsets: OffsetFrame | None = None
    face_truth: Path | None = None
    label: str = ""

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance_ms <= 1e9:
            found = f"{self.tolerance_ms} ms"
            raise UsageError("tolerance out of range", found=found, expected="0 to 1e9 ms")
        if not abs(self.time_offset_s) <= LONGEST_OFFSET_S:
            found, expected = f"{self.time_offset_s} s", f"-{LONGEST_OFFSET_S:g} to {LONGEST_OFFSET_S:g} s"
            raise UsageError("time offset out of range", found=found, expected=expected)
        if self.align not in get_args(Alignment):
            known = ", ".join(get_args(Alignment))
            raise UsageError("unknown alignment", found=repr(self.align), expected=f"one of {known}")
        if self.joint_offsets not in (None, *get_args(OffsetFrame)):
            found, known = repr(self.joint_offsets), ", ".join(get_args(OffsetFrame))
            raise UsageError("unknown frame of joint offsets", found=found, expected=f"one of {known}")

    @property
    def tolerance_ns(self) -> int:
        """``tolerance_ms`` in nanoseconds."""
        return round(1e6 * self.tolerance_ms)


DEFAULT_OPTIONS = EvalOptions()


def evaluate(path: Path, options: EvalOptions = DEFAULT_OPTIONS, name: str | None = None) -> Evaluation:
    """Evaluate a result against ground truth, or without it if there is none.

    Args:
        path: the result; an unfinished or damaged one is evaluated over its readable frames.
        options: evaluation options.
        name: display name; defaults to the file name without extension.

    Raises:
        ResultError: not a result, or stamps of the result or the ground truth do not increase.
        TruthError: the ground truth cannot be read, or does not fit the subject.
        UsageError: the ground truth is the result itself, or lacks data that the options require.
        RecordingError: ``options.recording`` is not the recording of the result.
    """
    whole = read_result(path)
    result = whole.of(options.label) if options.label else whole
    if result.subject.name not in KINDS:
        found, expected = f"subject '{result.subject.name}'", " or ".join(KINDS)
        raise ResultError("no metrics for this subject", where=path, found=found, expected=expected)
    truth_losses, offset_s = LossLog(), options.time_offset_s
    known = identities(
        whole, options.truth, options.track, time_offset_s=offset_s, tolerance_ns=options.tolerance_ns
    )
    of = Identity(None) if known is None else known.of[result.subject.label]
    has_truth = known is None or of.truth is not None
    topic = result.topic_of_track(options.track)
    true = estimate_truth_topic(result, options.truth, of.truth) if has_truth else None
    fields, names = truth_fields(result.subject)
    wanted = {topic: track_fields(result)} | ({true: fields} if true else {})
    columns = result.columns_of(wanted, {true: names} if true and names else {}, SINGLE_FIELDS)
    track = track_of_columns(columns.pop(topic), result, name or plain_name(path))
    truth = None
    if has_truth:
        truth = load_truth(
            result,
            options.truth,
            time_offset_s=offset_s,
            losses=truth_losses,
            label=of.truth,
            columns=columns.pop(true) if true else None,
        )
    measured = _measured(result, track, truth, truth_losses, options)
    return measured if known is None else _with_identity(measured, known, of, whole)


def _with_identity(measured: Evaluation, known: Identities, of: Identity, whole: Result) -> Evaluation:
    """Return an evaluation with metrics and notes about the identities of several tracks."""
    is_first = measured.label == whole.labels[0]  # which reports for all tracks
    coverage = replace(
        measured.coverage,
        has_identities=True,
        identity_switches=of.switches,
        false_tracks=int(of.truth is None),
        missed_tracks=len(known.missed) if is_first else 0,
    )
    notes = [FALSE_TRACK] if of.truth is None else [f"ground truth: {of.truth}"] if of.truth else []
    if is_first and known.missed:
        notes.append(f"no track of: {', '.join(known.missed)}")
    metrics = {**measured.metrics, **coverage_metrics(coverage)}
    absent = {address: reason for address, reason in measured.absent.items() if address not in metrics}
    order = addresses(measured.subject, measured.track.point_names, measured.track.shape_names)
    metrics = {address: metrics[address] for address in order if address in metrics}
    return replace(
        measured, coverage=coverage, notes=(*notes, *measured.notes), metrics=metrics, absent=absent
    )


def _measured(
    result: Result, track: Track, truth: Track | None, truth_losses: LossLog, options: EvalOptions
) -> Evaluation:
    pairs = None if truth is None else _paired(track, truth, options)
    coverage = measure_coverage(track, truth, pairs, tolerance_ns=options.tolerance_ns)
    measures = Measures(_nothing(track, truth, options), notes=_run_notes(result, options))
    measures.metrics |= coverage_metrics(coverage)
    curve = offsets = judged = None
    if truth is not None and pairs is not None:
        measures.notes += truth_warnings(result, track, truth, options.truth)
        # All metrics below see the aligned track; the warnings above must see the original one.
        track = _aligned(measures, track, truth, pairs, options)
        if options.joint_offsets is not None:
            matched = Matched(track, truth, pairs)
            track, offsets = _without_offsets(measures, result, matched, options.joint_offsets)
        curve, judged = _against_truth(measures, result, Matched(track, truth, pairs), coverage)
    if options.face_truth is not None:
        face_metrics(measures, track, options.face_truth, options.tolerance_ns)
    # Series are restricted to matched frames, so that plots and comparisons show the evaluated ones.
    rows = np.arange(len(track), dtype=np.int64) if pairs is None else pairs.estimate
    _without_truth(measures, result, track, options, rows)
    metrics, absent = _in_order(measures, track, truth)
    return Evaluation(
        name=track.name,
        path=result.path,
        subject=track.subject,
        run=result.run,
        coverage=coverage,
        metrics=metrics,
        absent=absent,
        series=measures.series | _run_series(track, rows),
        series_stamp_ns=track.stamp_ns[rows],
        curve=curve,
        notes=tuple(measures.notes),
        losses=(*result.losses, *_of_truth(truth_losses.losses, options)),
        track=track,
        truth=truth,
        pairs=pairs,
        which=options.track,
        joint_offsets=offsets,
        judged=judged,
        counts=measures.counts,
        distributions=measures.distributions,
        track_series=measures.track_series,
        label=result.subject.label,
    )


def _of_truth(losses: tuple[Loss, ...], options: EvalOptions) -> Iterator[Loss]:
    """Yield the losses of the ground-truth file, marked as such."""
    name = "" if options.truth is None else f" {options.truth.name}"
    return (replace(loss, what=f"ground truth{name}: {loss.what}") for loss in losses)


def _nothing(track: Track, truth: Track | None, options: EvalOptions) -> str:
    """Return the reason to report if no estimate can be compared."""
    if not len(track):
        return EMPTY
    if truth is None:
        return NO_TRUTH
    if not len(truth):
        return "the ground truth is empty"
    if truth.frame_index is not None:
        return f"no annotated frame has an estimate: {truth.name}"
    nearest = truth.stamp_ns[nearest_rows(track.stamp_ns, truth.stamp_ns)]
    away = _readable(int(np.abs(track.stamp_ns - nearest).min()))
    return (
        f"no estimate has ground truth within {options.tolerance_ms:g} ms, the nearest is {away} away; "
        "see --truth-tolerance-ms and --time-offset-s"
    )


def _readable(duration_ns: int) -> str:
    return f"{1e-6 * duration_ns:.4g} ms" if duration_ns < 10**9 else f"{1e-9 * duration_ns:.3f} s"


def _run_notes(result: Result, options: EvalOptions) -> list[str]:
    notes = [SMOOTHED_NOTE] if options.track == SMOOTHED else []
    notes += [] if result.finished else ["unfinished run: evaluated over the frames written so far"]
    notes += [PRIOR_NOTE] if result.run.get("scale") == "prior" else []
    notes += [GUESS_NOTE] if result.run.get("intrinsics") == "guessed" else []
    notes += [_estimated(result.run)] if result.run.get("intrinsics") == "estimated" else []
    stored = {"part of the run's input was unusable": "losses", "run remarks": "remarks"}
    return notes + [f"{what}: {result.summary[key]}" for what, key in stored.items() if key in result.summary]


def _estimated(run: Mapping[str, str]) -> str:
    focal = f"{run.get('focal_px', '')} +- {run.get('focal_sd_px', '')} px"
    return f"uncalibrated camera: the focal length is estimated as {focal}, and the distance scales with it"


def _paired(track: Track, truth: Track, options: EvalOptions) -> Pairs:
    # Annotated images have interpolated stamps, so frame numbers are more reliable.
    if truth.frame_index is not None and track.frame_index is not None:
        return associate_frames(track.frame_index, truth.frame_index)
    return associate(track.stamp_ns, truth.stamp_ns, options.tolerance_ns)


def _aligned(measures: Measures, track: Track, truth: Track, pairs: Pairs, options: EvalOptions) -> Track:
    """Return the estimate aligned as requested, and add a note about the alignment."""
    if options.align == "none":
        return track
    points, scale = options.align == "rigid+points", options.align == "similarity"
    aligned, note = remove_constant_offset(track, truth, pairs, points, scale)
    remark = "" if scale else common_factor(track, truth, pairs)
    measures.notes += [note, remark] if remark else [note]
    return aligned


def _without_offsets(
    measures: Measures, result: Result, matched: Matched, frame: OffsetFrame
) -> tuple[Track, JointOffsets | None]:
    """Return the estimate without the constant offset of each joint, and add a note about it."""
    remove_offsets = KINDS[result.subject.name].remove_offsets
    if remove_offsets is None:
        found = f"a {result.subject.name}"
        raise UsageError("--joint-offsets requires a hand", where=result.path, found=found)
    track, offsets = remove_offsets(result, matched, frame)
    measures.notes.append(NO_FRAME if offsets is None else offsets.note)
    return track, offsets


def _against_truth(
    measures: Measures, result: Result, matched: Matched, coverage: Coverage
) -> tuple[Curve | None, JudgedFrames | None]:
    if not len(matched):
        measures.notes.append(measures.nothing)
    kind = KINDS[matched.estimate.subject]
    curve = kind.measure(measures, matched, coverage.missed)
    if kind.measure_of_result is not None:
        kind.measure_of_result(measures, result, matched)
    # Judges by the error series that the calls above have added.
    judged = judged_frames(measures, matched, kind)
    if judged is not None:
        honesty_metrics(measures, judged)
    return curve, judged


def _without_truth(
    measures: Measures, result: Result, track: Track, options: EvalOptions, rows: IntArray
) -> None:
    """Add the metrics that need no ground truth; image series are restricted to ``rows`` of the track."""
    consistency_metrics(measures, track)
    if options.recording is not None:
        _against_images(measures, result, options, rows)
    run_metrics(measures, track, result.run)


def _against_images(measures: Measures, result: Result, options: EvalOptions, rows: IntArray) -> None:
    # Imported here, as it loads the readers of all recording formats.
    from posetrack_cli.evaluation.reading.recording_of import required_recording

    recording = required_recording(result, options.recording)
    compare_images = KINDS[result.subject.name].compare_images
    if compare_images is None:
        return
    found = compare_images(result, recording, options.track)
    measures.lack(NO_OVERLAP if found else NO_IMAGES, "residual_mm", "region_overlap")
    for name, values in found.items():
        known = np.isfinite(values)
        if known.any():
            measures.summarise(name, values[known])
            measures.track_series[name] = values
        if known[rows].any():
            measures.series[name] = rows_of(values, rows)


def coverage_metrics(coverage: Coverage) -> dict[str, Value]:
    """Return frame counts by metric name; those that need ground truth only if there is one."""
    counts: dict[str, float] = {
        "coverage": coverage.share,
        "frames": coverage.frames,
        "tracked": coverage.tracked,
        "lost": coverage.lost,
        "reinitialised": coverage.reinitialised,
    }
    if coverage.has_truth:
        counts["matched"] = coverage.frames - coverage.unmatched
        counts["unmatched"] = coverage.unmatched
        counts["missed"] = coverage.missed
        counts["truth_outside"] = coverage.outside
    if coverage.has_identities:
        counts["identity_switches"] = coverage.identity_switches
        counts["false_tracks"] = coverage.false_tracks
        counts["missed_tracks"] = coverage.missed_tracks
    return {name: float(count) for name, count in counts.items()}


def _run_series(track: Track, rows: IntArray) -> dict[str, FloatArray]:
    """Return the stored per-frame values of these rows, without columns that are all NaN."""
    series = {name: rows_of(values, rows) for name, values in run_series(track).items()}
    return {name: values for name, values in series.items() if np.isfinite(values).any()}


def _in_order(
    measures: Measures, track: Track, truth: Track | None
) -> tuple[dict[str, Value], dict[str, str]]:
    """Return metrics in catalogue order, and reasons for all other addresses of the subject."""
    known = addresses(track.subject, track.point_names, track.shape_names)
    metrics = {address: measures.metrics[address] for address in known if address in measures.metrics}
    absent = {address: _reason(measures, address, truth) for address in known if address not in metrics}
    return metrics, absent


def _reason(measures: Measures, address: str, truth: Track | None) -> str:
    """Return why an address has no value: its own or its metric's reason, else that of its group."""
    metric = metric_of(address)
    if address in FACE_NAMES:
        return measures.absent.get(address, NO_EYES if address in GAZE_NAMES else NO_LANDMARKS)
    if truth is None and metric.group in (*AGAINST_TRUTH, "coverage"):
        return NO_TRUTH
    reason = measures.absent.get(address) or measures.absent.get(metric.name)
    part = address.removeprefix(metric.name).removeprefix(".")
    return reason or (f"the ground truth has no {part}" if part else WITHOUT_TRUTH.get(address, EMPTY))
