"""Measure a result: read it, find its truth, pair the two, and fill the catalogue."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from posetrack_cli.arrays import FloatArray, IntArray
from posetrack_cli.errors import ResultError, UsageError
from posetrack_cli.evaluation.measuring.catalogue import addresses, metric_of
from posetrack_cli.evaluation.measuring.evaluation import Curve, Evaluation, Value
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
from posetrack_cli.evaluation.reading.tracks import (
    Coverage,
    Pairs,
    Track,
    associate,
    associate_frames,
    measure_coverage,
    nearest_rows,
    plain_name,
    track_of_result,
)
from posetrack_cli.evaluation.reading.truth import load_truth
from posetrack_cli.evaluation.reading.truth_tables import truth_warnings
from posetrack_cli.losses import Loss, LossLog
from posetrack_cli.results.channels import FILTERED, SMOOTHED
from posetrack_cli.results.reader import Result, read_result

Alignment: TypeAlias = Literal["none", "rigid", "rigid+points", "similarity"]

AGAINST_TRUTH = ("accuracy", "velocity", "covariance", "honesty")
LONGEST_OFFSET_S = 1e10
"""What 64 bits of nanoseconds hold, nearly 300 years, is a little less."""
SMOOTHED_NOTE = "the smoothed track: its estimates rest on later frames, too"
PRIOR_NOTE = "one camera sees no scale: distance and size rest on what faces are like"
GUESS_NOTE = "the camera was not calibrated: the focal length, and distance with it, is a guess"
NO_TRUTH = "no truth: the result carries none, and none was given with --truth"
NO_IMAGES = "the recording has none of the result's frames"
NO_OVERLAP = "in no frame the estimate and the observed hand overlap"
NO_RECORDING = "needs the images: give the recording with --recording"
WITHOUT_TRUTH = {
    "residual_mm": NO_RECORDING,
    "region_overlap": NO_RECORDING,
    "cost_mm": "the run gave no estimate a cost",
    "jitter_mm": "no three frames in a row",
    "gaps": "fewer than two frames",
    "largest_gap_s": "fewer than two frames",
}
"""Why these have no value, when they have none."""


@dataclass(frozen=True)
class EvalOptions:
    """How results are measured.

    Attributes:
        truth: a file to take the truth from; None takes the one that the result carries.
        tolerance_ms: how far apart the stamps of an estimate and its truth may be.
        time_offset_s: added to the stamps of the truth.
        align: ``rigid`` removes one constant rigid offset first, ``rigid+points`` each point's own, too,
            ``similarity`` one factor on all lengths and one constant rigid offset.
        recording: what the result was made from, to measure it against the images; None leaves that out.
        track: which of the result's tracks.
        joint_offsets: whose axes the constant offset of each of a hand's joints is removed in, see
            ``remove_joint_offsets``; None removes none.

    Raises:
        UsageError: a number that cannot be meant, or an unknown alignment.
    """

    truth: Path | None = None
    tolerance_ms: float = 5.0
    time_offset_s: float = 0.0
    align: Alignment = "none"
    recording: Path | None = None
    track: str = FILTERED
    joint_offsets: OffsetFrame | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.tolerance_ms <= 1e9:
            found = f"{self.tolerance_ms} ms"
            raise UsageError("tolerance cannot be used", found=found, expected="0 to 1e9 ms")
        if not abs(self.time_offset_s) <= LONGEST_OFFSET_S:
            found, expected = f"{self.time_offset_s} s", f"at most {LONGEST_OFFSET_S:g} s either way"
            raise UsageError("time offset cannot be used", found=found, expected=expected)
        if self.align not in get_args(Alignment):
            known = ", ".join(get_args(Alignment))
            raise UsageError("no such alignment", found=repr(self.align), expected=f"one of {known}")
        if self.joint_offsets not in (None, *get_args(OffsetFrame)):
            found, known = repr(self.joint_offsets), ", ".join(get_args(OffsetFrame))
            raise UsageError("no such axes of joints' offsets", found=found, expected=f"one of {known}")

    @property
    def tolerance_ns(self) -> int:
        """The tolerance in nanoseconds."""
        return round(1e6 * self.tolerance_ms)


DEFAULT_OPTIONS = EvalOptions()


def evaluate(path: Path, options: EvalOptions = DEFAULT_OPTIONS, name: str | None = None) -> Evaluation:
    """Measure one result against its truth, or by itself where there is none.

    Args:
        path: the result; an unfinished or damaged one is measured over what it holds.
        options: how.
        name: what tables call it; by default the file's name without its ending.

    Raises:
        ResultError: it is no result, or its stamps or those of its truth do not increase.
        TruthError: the truth cannot be read, or is of something else.
        UsageError: the truth is the result itself, or does not have what the options ask for.
        RecordingError: ``options.recording`` is not what the result was made from.
    """
    result = read_result(path)
    if result.subject.name not in KINDS:
        found, expected = f"subject '{result.subject.name}'", " or ".join(KINDS)
        raise ResultError("is of a subject that has no metrics", where=path, found=found, expected=expected)
    track = track_of_result(result, name or plain_name(path), options.track)
    truth_losses = LossLog()
    truth = load_truth(result, options.truth, time_offset_s=options.time_offset_s, losses=truth_losses)
    return _measured(result, track, truth, truth_losses, options)


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
        track = _aligned(measures, track, truth, pairs, options)
        if options.joint_offsets is not None:
            matched = Matched(track, truth, pairs)
            track, offsets = _without_offsets(measures, result, matched, options.joint_offsets)
        curve, judged = _against_truth(measures, result, Matched(track, truth, pairs), coverage)
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
    )


def _of_truth(losses: tuple[Loss, ...], options: EvalOptions) -> Iterator[Loss]:
    """Losses of the file that is given as truth, told apart from the result's own."""
    name = "" if options.truth is None else f" {options.truth.name}"
    return (replace(loss, what=f"truth{name}: {loss.what}") for loss in losses)


def _nothing(track: Track, truth: Track | None, options: EvalOptions) -> str:
    """Why no estimate is compared, should there be none."""
    if not len(track):
        return EMPTY
    if truth is None:
        return NO_TRUTH
    if not len(truth):
        return "the truth is empty"
    if truth.frame_index is not None:
        return f"no estimate is of an annotated frame: {truth.name}"
    nearest = truth.stamp_ns[nearest_rows(track.stamp_ns, truth.stamp_ns)]
    away = _readable(int(np.abs(track.stamp_ns - nearest).min()))
    return (
        f"no estimate has a truth within {options.tolerance_ms:g} ms: the nearest is {away} away; "
        "see --truth-tolerance-ms and --time-offset-s"
    )


def _readable(duration_ns: int) -> str:
    return f"{1e-6 * duration_ns:.4g} ms" if duration_ns < 10**9 else f"{1e-9 * duration_ns:.3f} s"


def _run_notes(result: Result, options: EvalOptions) -> list[str]:
    notes = [SMOOTHED_NOTE] if options.track == SMOOTHED else []
    notes += [] if result.finished else ["the run did not finish: measured over the frames that it holds"]
    notes += [PRIOR_NOTE] if result.run.get("scale") == "prior" else []
    notes += [GUESS_NOTE] if result.run.get("intrinsics") == "guessed" else []
    told = {"the run could not use all of its input": "losses", "the run remarks": "remarks"}
    return notes + [f"{what}: {result.summary[key]}" for what, key in told.items() if key in result.summary]


def _paired(track: Track, truth: Track, options: EvalOptions) -> Pairs:
    if truth.frame_index is not None and track.frame_index is not None:
        return associate_frames(track.frame_index, truth.frame_index)
    return associate(track.stamp_ns, truth.stamp_ns, options.tolerance_ns)


def _aligned(measures: Measures, track: Track, truth: Track, pairs: Pairs, options: EvalOptions) -> Track:
    """The estimate without its constant offset, as far as the options ask for it; a note says so."""
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
    """The estimate without the constant offset of each joint, which a note tells about."""
    remove_offsets = KINDS[result.subject.name].remove_offsets
    if remove_offsets is None:
        found = f"a {result.subject.name}"
        raise UsageError("--joint-offsets is for hands", where=result.path, found=found)
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
    judged = judged_frames(measures, matched, kind)
    if judged is not None:
        honesty_metrics(measures, judged)
    return curve, judged


def _without_truth(
    measures: Measures, result: Result, track: Track, options: EvalOptions, rows: IntArray
) -> None:
    """Add self-consistency and what the run says about itself; series of these rows of the track."""
    consistency_metrics(measures, track)
    if options.recording is not None:
        _against_images(measures, result, options, rows)
    run_metrics(measures, track, result.run)


def _against_images(measures: Measures, result: Result, options: EvalOptions, rows: IntArray) -> None:
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
    """The counts of a coverage by metric; those about a truth only where there is one."""
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
    return {name: float(count) for name, count in counts.items()}


def _run_series(track: Track, rows: IntArray) -> dict[str, FloatArray]:
    """What the run says about these frames, as far as it says anything."""
    series = {name: rows_of(values, rows) for name, values in run_series(track).items()}
    return {name: values for name, values in series.items() if np.isfinite(values).any()}


def _in_order(
    measures: Measures, track: Track, truth: Track | None
) -> tuple[dict[str, Value], dict[str, str]]:
    """Metrics in the catalogue's order, and of every other address of the subject why it has none."""
    known = addresses(track.subject, track.point_names, track.shape_names)
    metrics = {address: measures.metrics[address] for address in known if address in measures.metrics}
    absent = {address: _reason(measures, address, truth) for address in known if address not in metrics}
    return metrics, absent


def _reason(measures: Measures, address: str, truth: Track | None) -> str:
    """Why an address has no value: as told for it or its whole, else as its group has it."""
    metric = metric_of(address)
    if truth is None and metric.group in (*AGAINST_TRUTH, "coverage"):
        return NO_TRUTH
    told = measures.absent.get(address) or measures.absent.get(metric.name)
    part = address.removeprefix(metric.name).removeprefix(".")
    return told or (f"the truth has no {part}" if part else WITHOUT_TRUTH.get(address, EMPTY))
